"""Measured labels, the labels that theory predicts, and trajectories."""
