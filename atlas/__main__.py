"""python -m atlas is the atlas command."""

from .cli import command

if __name__ == "__main__":
    command()
