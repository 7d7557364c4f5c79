"""Instruments: measurements of runs, their errors, the labels that follow, and their variables."""
