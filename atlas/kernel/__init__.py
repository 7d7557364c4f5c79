"""The engine integrates any system: it computes with floats and arrays only, and imports nothing from above."""
