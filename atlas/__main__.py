"""Run the atlas command by python -m atlas."""

from .cli import command

if __name__ == "__main__":
    command()
