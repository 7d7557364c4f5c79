"""Files: atlases, their provenance, and progress."""
