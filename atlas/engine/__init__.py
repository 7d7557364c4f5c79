"""The engine integrates any system: it knows floats and arrays only, and imports nothing from above."""
