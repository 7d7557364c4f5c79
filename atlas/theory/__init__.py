"""Theory of one point in functions of numbers, which run as plain Python or in machine code (see `compiled`)."""
