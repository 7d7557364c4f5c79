"""A system of another package, a scene of it, and functions that write packages (module and metadata) into a folder."""

import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from atlas import systems

EXAMPLES = Path(__file__).parents[1] / "docs" / "examples"

PENDULUM = '''
"""A pendulum with a cubic spring: a system that no line of the package is about."""

import numpy as np
from numpy import cos, sin

from atlas.systems import Observable, Parameter, System


class Pendulum(System):
    """x'' = -omega^2 sin x - cubic x^3."""

    name = "pendulum"
    title = "pendulum with a spring"

    class equations:
        STATE = ("x", "v")
        CONSTANTS = ("omega", "cubic")
        INTEGRALS = ("energy",)

        def rhs(state, constants):
            x, v = state
            omega, cubic = constants
            return v, -(omega**2) * sin(x) - cubic * x * x * x

        def energy(state, constants):
            x, v = state
            omega, cubic = constants
            return 0.5 * v * v, omega**2 * (1 - cos(x)), 0.25 * cubic * x**4

        def height(state, constants):
            x, v = state
            return 1 - cos(x)

    parameters = {
        parameter.name: parameter
        for parameter in (
            Parameter("omega", "rad s-1", "frequency of small oscillations", 1.0, 0.0),
            Parameter("cubic", "s-2", "cubic spring", 0.0, 0.0),
            Parameter("x0", "rad", "angle at the start", 0.5, start=True),
            Parameter("v0", "rad s-1", "rate at the start", start=True),
        )
    }
    observables = (
        Observable("x", "rad", "angle", symbol="$x$"),
        Observable("height", "1", "height of the bob", tolerance=0.01),
    )

    def initial_state(self, points):
        return np.array([points["x0"], points["v0"]])
'''

PENDULUM_SCENE = """
schema = 1
title = "A pendulum"
system = "pendulum"

[fixed]
cubic = 0.1   # no term vanishes, so that the kernel is that of other tests

[axes.omega]
from = 0.5
to = 2.0
count = 12

[axes.x0]
from = 0.0
to = 2.5
count = 9

[integration]
duration = 20.0
tolerance = 1e-6
method = "rk8"

[labels.std_tolerance]
x = 0.5
"""


@contextmanager
def registry() -> Iterator[None]:
    """Context that forgets, at its end, the systems that were registered in it."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(systems, "SYSTEMS", dict(systems.SYSTEMS))
        yield


def write_metadata(folder, name, version, groups):
    """Write the metadata of a package into a folder; groups: group of entry points -> entry point -> object."""
    info = folder / f"{name.replace('-', '_')}-{version}.dist-info"
    info.mkdir(exist_ok=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    lines = []
    for group, names in groups.items():
        lines += [f"[{group}]", *(f"{key} = {value}" for key, value in names.items())]
    (info / "entry_points.txt").write_text("\n".join([*lines, ""]))


def install(folder, module, text, names, package="some-systems", version="1.2"):
    """Write a module and the metadata of its package into a folder; names: entry point -> object."""
    (folder / f"{module}.py").write_text(text)
    write_metadata(folder, package, version, {"atlas.systems": names})


def install_example(name, folder):
    """Write the metadata that pip would write for a package in docs/examples; returns the folder of its modules."""
    project = tomllib.loads((EXAMPLES / name / "pyproject.toml").read_text())["project"]
    write_metadata(folder, project["name"], project["version"], project["entry-points"])
    return EXAMPLES / name
