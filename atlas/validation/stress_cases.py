"""Stiff and extreme points of each system."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import systems
from ..scene.tables import point_columns
from ..systems.base import Array, Points, System


@dataclass(frozen=True)
class StressCase:
    """Points of one kind."""

    name: str
    text: str
    points: Points
    duration: Array  # (points,), time units
    names: tuple[str, ...]  # of the points, within the case
    may: str = ""  # why an automatic step, too, may leave a point unresolved


class _Maker:
    def __init__(self, system: System):
        self.system = system

    def __call__(
        self,
        name: str,
        text: str,
        duration: Any = 20.0,
        *,
        solve: tuple[str, str] | None = None,
        add: Mapping[str, Any] | None = None,
        may: str = "",
        **columns: Any,
    ) -> StressCase:
        """A case: parameters as numbers or columns, solve = (family, parameter), then add to parameters."""
        varying = {k: np.asarray(v, float) for k, v in ({**columns, **(add or {})}).items() if np.ndim(v)}
        size = max((v.size for v in varying.values()), default=1)
        columns.setdefault("phi0", np.zeros(size))
        points, size = point_columns(self.system, columns)
        if solve is not None:
            points[solve[1]] = self.system.families[solve[0]].solve[solve[1]](points)
        for key, value in (add or {}).items():
            points[key] = points[key] + value
        names = [", ".join(f"{k} = {v[i]:.4g}" for k, v in varying.items() if v.any()) for i in range(size)]
        times = np.broadcast_to(np.asarray(duration, float), (size,)).copy()
        return StressCase(name, text, points, times, tuple(names), may)


OVERFLOW = "the numbers overflow"
GROWN = "the method's own error grows with the motion before rounding does"


def _decades(first: int, last: int, every: int = 1) -> Array:
    return np.asarray(10.0 ** np.arange(first, last + every / abs(every), every))


def satellite_cases() -> list[StressCase]:
    """The cases of the satellite; Omega = 1 but where it is said."""
    case = _Maker(systems.get("satellite"))
    tilted: dict[str, Any] = {"theta0": 0.6, "psi0": 0.3, "m": 0.5}
    hyperbola: dict[str, Any] = {"theta0": 0.8, "psi0": np.pi / 2, "C": 0.7}  # a stable perp_velocity motion
    unstable: dict[str, Any] = {"theta0": 1.0, "psi0": np.pi / 2, "C": 1.2, "m": 0.3}
    fast, up = _decades(0, 6), _decades(-2, -12, -2)
    spins, fields = _decades(-6, 4, 2), _decades(-8, 6, 2)
    tilts = np.array([1e-2, 1e-3, 1e-4, 3e-5, 1e-6, 1e-8, 1e-12, 0.0])
    flip: dict[str, Any] = {"A": 1.0, "B": 2.0, "C": 1.5, "Omega": 0.0, "m": 1.0}
    return [
        case("stiff rotor", "rotor frequency over the slow one", np.minimum(20, 2e3 / fast), k3=fast,
             theta_dot0=0.1, **tilted),
        case("stiff spin", "fast spin with the rotor against it: the axis moves slowly", np.minimum(20, 2e3 / fast),
             k3=0.3 - 1.2 * fast, theta0=0.6, psi0=0.3, m=fast),
        case("stiff steady", "the same on an exact steady motion", np.minimum(20, 2e3 / fast),
             solve=("perp_velocity", "k3"), m=fast, **hyperbola),
        case("spin", "exact regular precession of a spherical body, slow to fast spin", np.minimum(20, 2e3 / spins),
             solve=("spherical", "k3"), C=1.0, n=0.5, theta0=1.0, m=spins),
        case("needle", "C towards 0", 20.0, C=_decades(-1, -6, -1), **tilted),
        case("flat body", "A + B = C", 20.0, A=np.array([1.0, 0.3, 1e-3]), B=np.array([1.0, 0.7, 1.0]),
             C=np.array([2.0, 1.0, 1.001]), **tilted),
        case("needle across", "A towards 0", np.array([20.0, 5.0, 1.0]), A=_decades(-2, -6, -2), C=1.0, **tilted),
        case("near 0", "tilts of a stable cylindrical motion", 20.0, theta0=tilts, C=1.3, m=1.5),
        case("near pi", "the same upside down", 20.0, theta0=np.pi - tilts, C=1.3, m=-3.5),
        case("steep precession", "exact regular precession close to the vertical", 20.0,
             solve=("spherical", "k3"), C=1.0, n=0.5, m=0.7, theta0=np.array([1e-1, 1e-2, 1e-3, 1e-4])),
        case("through the pole", "great circles through the vertical", 5.0,
             Omega=np.array([0.0, 1.0, 1.0]), theta0=0.5, theta_dot0=-3.0, k3=np.array([0.0, 0.0, 0.2])),
        case("field", "magnet in weak to strong fields", np.minimum(20, 30 / np.sqrt(fields)),
             mu3=1.0, mu1=0.2, h1=fields, h3=0.3 * fields, **tilted),
        case("weak field", "a steady motion that a field disturbs", 20.0, solve=("perp_velocity", "k3"),
             add={"h1": _decades(-12, -4, 2)}, mu1=1.0, m=0.4, **hyperbola),
        case("separatrix", "beside an unstable motion", 30.0, solve=("perp_velocity", "k3"), add={"theta0": up},
             **unstable),
        case("racket", "free body about its middle axis, pushed a little", 60.0, theta_dot0=up, **flip),
        case("unstable, short", "exactly on an unstable motion", 20.0, solve=("perp_velocity", "k3"),
             **unstable | {"m": np.array([0.3, 3.0, 30.0])}),
        case("unstable, middle", "the same, longer", 50.0, solve=("perp_velocity", "k3"), may=GROWN,
             **unstable | {"m": np.array([0.3, 3.0, 30.0])}),
        case("unstable, long", "the same, until rounding decides", 500.0, solve=("perp_velocity", "k3"), **unstable),
        case("hidden growth", "fast spin on top of slow growth", 40.0, solve=("perp_velocity", "k3"),
             add={"theta0": np.array([1e-4, 1e-5, 1e-6])}, **unstable | {"m": 60.0}),
        case("slower than the run", "a weak gravity gradient", 4.0, C=1.0 + _decades(-2, -8, -2), **tilted | {"m": -1.0}),
        case("10 000 orbits", "exactly steady, and drifting", 2e4 * np.pi, solve=("perp_velocity", "k3"),
             add={"theta0": np.array([0.0, 0.3])}, m=0.4, **hyperbola),
        case("Omega = 0", "free and heavy bodies that orbit nothing", 20.0, Omega=0.0, theta0=np.array([0.0, 0.7, 0.7]),
             m=0.5, n=np.array([0.0, 0.0, 0.4]), h3=np.array([0.0, 0.0, 1.0]), mu3=1.0),
        case("at rest", "nothing turns at all", 20.0, Omega=0.0, theta0=np.array([0.0, 0.5])),
        case("denormal", "parameters of 1e-300 and less", 20.0, theta0=np.array([1e-310, 0.5, 0.5]),
             k1=np.array([1e-310, 0.0, 1e-320]), m=np.array([0.5, 1e-300, 1e-310]), h1=1e-310, mu2=1e-310),
        case("overflow", "products of parameters overflow", 20.0, may=OVERFLOW, theta0=0.5,
             k1=np.array([1e200, 0.0, 0.0, 0.0]), m=np.array([0.0, 1e300, 0.0, 0.0]),
             mu1=np.array([0.0, 0.0, 1e300, 0.0]), h1=np.array([0.0, 0.0, 1e300, 0.0]),
             n=np.array([0.0, 0.0, 0.0, 1e160])),
    ]  # fmt: skip


def fixed_point_cases() -> list[StressCase]:
    """The cases of the gyrostat about a fixed point."""
    case = _Maker(systems.get("fixed_point"))
    heavy: dict[str, Any] = {"Mg": 1.0, "z0": 0.5, "N": 0.1}
    tilted: dict[str, Any] = {"theta0": 0.6, "m": 0.5, "n": 0.2} | heavy
    cone: dict[str, Any] = {"theta0": 0.8, "n": 0.5, "C": 0.7} | heavy
    fast, up = _decades(0, 6), _decades(-2, -12, -2)
    spins, fields = _decades(-6, 4, 2), _decades(-8, 6, 2)
    tilts = np.array([1e-2, 1e-3, 1e-4, 3e-5, 1e-6, 1e-8, 1e-12, 0.0])
    flip: dict[str, Any] = {"A": 1.0, "B": 2.0, "C": 1.5, "m": 1.0}
    middle: dict[str, Any] = {"A": 1.0, "B": 1.5, "C": 2.0, "theta0": np.pi / 2, "n": 1.0}
    # conical motions are unstable where N (A - C) > A n^2 only, at small C r + l3
    steep: dict[str, Any] = {"A": 1.0, "C": 0.4, "N": 3.0, "n": 0.5, "theta0": 1.0, "Mg": 1.0}
    paper: dict[str, Any] = {
        "A": np.array([22.49, 50.32]),
        "B": np.array([22.49, 50.32]),
        "C": np.array([35.6, 33.4]),
    }
    return [
        case("stiff rotor", "rotor frequency over the slow one", np.minimum(20, 2e3 / fast), l3=fast,
             theta_dot0=0.1, **tilted),
        case("stiff spin", "fast spin with the rotor against it: the axis moves slowly", np.minimum(20, 2e3 / fast),
             l3=0.6 - 1.2 * fast, **tilted | {"m": fast}),
        case("stiff steady", "the same on an exact regular precession", np.minimum(20, 2e3 / fast),
             solve=("conical", "l3"), m=fast, **cone),
        case("spin", "exact regular precession, slow to fast spin", np.minimum(20, 2e3 / spins),
             solve=("conical", "l3"), m=spins, **cone),
        case("r0 = 1000", "the paper's bodies and spin", 2.0, Mg=294.3, z0=5.0, theta0=0.5, m=1000.0,
             l3=np.array([0.0, 50.0]), **paper),
        case("needle", "C towards 0", 20.0, C=_decades(-1, -6, -1), **tilted),
        case("flat body", "A + B = C", 20.0, A=np.array([1.0, 0.3, 1e-3]), B=np.array([1.0, 0.7, 1.0]),
             C=np.array([2.0, 1.0, 1.001]), **tilted),
        case("needle across", "A towards 0", np.array([20.0, 5.0, 1.0]), A=_decades(-2, -6, -2), C=1.0, **tilted),
        case("near 0", "tilts of a stable sleeping top", 20.0, theta0=tilts, m=1.5, **heavy),
        case("near pi", "the same upside down", 20.0, theta0=np.pi - tilts, m=3.5, **heavy),
        case("steep precession", "exact regular precession close to the vertical", 20.0,
             solve=("conical", "l3"), m=0.7, **cone | {"theta0": np.array([1e-1, 1e-2, 1e-3, 1e-4])}),
        case("through the pole", "planar pendulum and fast tops through the vertical", 5.0,
             theta0=0.5, theta_dot0=-3.0, l3=np.array([0.0, 0.2]), **heavy),
        case("field", "weak to strong weight and gradient", np.minimum(20, 30 / np.sqrt(fields)),
             Mg=fields, N=0.3 * fields, x0=0.2, z0=0.5, theta0=0.6, m=0.5),
        case("weak field", "a steady motion that an offset disturbs", 20.0, solve=("conical", "l3"),
             add={"x0": _decades(-12, -4, 2)}, m=0.4, **cone),
        case("separatrix", "a pendulum beside its upper rest", 15.0, theta0=np.pi - up, **heavy),
        case("racket", "free body about its middle axis, pushed a little", 60.0, theta_dot0=up, **flip),
        case("unstable, short", "exactly on an unstable motion", 12.0, **middle | {"n": np.array([1.0, 0.3])}),
        case("unstable cone, short", "exactly on an unstable regular precession", 8.0, solve=("conical", "z0"),
             **steep | {"m": np.array([0.3, 3.0])}),
        case("unstable cone, middle", "the same, longer", 20.0, solve=("conical", "z0"), may=GROWN,
             **steep | {"m": np.array([0.3, 3.0])}),
        case("unstable, long", "until rounding decides", 200.0, **middle),
        case("hidden growth", "fast spin on top of slow growth", 15.0, m=60.0, l3=0.4 * (0.3 - 60.0),
             solve=("conical", "z0"), add={"theta0": np.array([1e-4, 1e-5, 1e-6])}, **steep),
        case("slower than the run", "weak weight", 4.0, Mg=_decades(-2, -8, -2), z0=1.0, theta0=0.6),
        case("long", "exactly steady, and drifting, for 10 000 turns", 4e4 * np.pi, solve=("conical", "l3"),
             add={"theta0": np.array([0.0, 0.3])}, m=0.4, **cone),
        case("at rest", "nothing turns at all", 20.0, theta0=np.array([0.0, 0.5])),
        case("denormal", "parameters of 1e-300 and less", 20.0, theta0=np.array([1e-310, 0.5, 0.5]),
             l1=np.array([1e-310, 0.0, 1e-320]), m=np.array([0.5, 1e-300, 1e-310]), Mg=1e-310, x0=1e-310),
        case("overflow", "products of parameters overflow", 20.0, may=OVERFLOW, theta0=0.5,
             l1=np.array([1e200, 0.0, 0.0, 0.0]), theta_dot0=0.1, m=np.array([0.0, 1e300, 0.0, 0.0]),
             Mg=np.array([0.0, 0.0, 1e300, 0.0]), x0=np.array([0.0, 0.0, 1e300, 0.0]),
             n=np.array([0.0, 0.0, 0.0, 1e160])),
    ]  # fmt: skip


STRESS_CASES: dict[str, Callable[[], list[StressCase]]] = {
    "satellite": satellite_cases,
    "fixed_point": fixed_point_cases,
}
