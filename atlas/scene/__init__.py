"""Scenes: job files read and checked, and their grids of points."""
