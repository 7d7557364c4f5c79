"""The kernel: integration of any system with floats and arrays only, step sizes, statistics, generated and cached machine code."""
