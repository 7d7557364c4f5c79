"""Relative equilibria against a parameter, and their numbers on maps."""

from ...extension import Extension

COUNTS = ("equilibrium_count", "equilibrium_stable_count", "equilibrium_energy_stable_count")

EXTENSION = Extension(
    "branches",
    __name__,
    "branches of equilibria, their bifurcations, and borders over two parameters; numbers of equilibria on maps",
    needs=("equilibria",),
    functions={"branches": "branches:branches", "borders": "borders:borders"},
    questions={"diagram": "diagram:diagram", "borders": "borders:borders_of_atlas"},
    commands={"branches": "commands:draw_branches"},
    variables=dict.fromkeys(COUNTS, "counts:count_variables"),
    lines=dict(zip(COUNTS, ("lines:of_all", "lines:of_stable", "lines:of_minima"), strict=True)),
)
