"""Error against run time, half steps, a tight reference, stiff and extreme cases."""
