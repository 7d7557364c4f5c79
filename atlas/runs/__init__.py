"""Computation of a scene in tiles, in memory, in a folder or on a cluster, with refinement, reuse, claims and dry runs."""
