"""Reading and checking of scenes, and the points of their grids."""
