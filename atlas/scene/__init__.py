"""Scenes: job files as checked dataclasses, and the points of their grids."""
