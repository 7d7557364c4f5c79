"""Theory of one point: functions of numbers, which run as plain Python or compiled, see `compiled`."""
