"""The extensions of this package: nothing in the core imports them."""
