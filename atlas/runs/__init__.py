"""A scene computed in tiles, in memory, in a folder or on a cluster; refinement, reuse, claims, dry runs."""
