"""All relative equilibria, or permanent rotations about the vertical, of given bodies."""

from ...extension import Extension

EXTENSION = Extension(
    "equilibria",
    __name__,
    "all relative equilibria, or permanent rotations about the vertical, of given bodies",
    functions={"equilibria": "dataset:equilibria"},
    methods={"equilibria": "bodies:equilibria", "equilibria_of_bodies": "bodies:equilibria_of_bodies"},
)
