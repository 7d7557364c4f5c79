"""Integration of any system with floats and arrays alone, including step sizes, statistics and cached machine code."""
