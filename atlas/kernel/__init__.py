"""The kernel: any system integrated with floats and arrays only; step sizes, statistics, generated and cached machine code."""
