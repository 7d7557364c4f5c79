"""Computation of a scene by tiles, either in memory, in a folder or on a cluster, with refinement, reuse, claims and dry runs."""
