"""Checks of the numbers: half steps, a tight reference, work-precision studies, stress cases."""
