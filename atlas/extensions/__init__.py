"""The extensions of this package, which nothing in the core imports."""
