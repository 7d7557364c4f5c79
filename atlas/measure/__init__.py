"""Instruments, which measure runs and give labels, errors and the variables of an atlas."""
