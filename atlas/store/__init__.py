"""Storage of runs and of finished atlases, in folders and on object stores."""
