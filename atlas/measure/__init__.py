"""Instruments: what is measured of runs, the labels that follow, their errors, and the variables that hold them."""
