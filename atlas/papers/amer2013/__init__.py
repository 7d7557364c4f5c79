"""Amer, Abo Essa, Ibrahim & Amer 2013: the gyrostat about a fixed point in a central Newtonian field."""
