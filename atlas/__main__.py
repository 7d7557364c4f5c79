"""python -m atlas is the atlas command."""

import sys

from .cli import main

if __name__ == "__main__":
    sys.exit(main())
