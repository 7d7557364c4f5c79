"""Excursions of gyroscopically stabilised symmetric satellites in long runs, by their nonlinear stability from theory.

    python scripts/tools/nonlinear_runs.py [--points N] [--duration T] [--nudges ANGLE ...] [--starts N]

The motions are random cylindrical motions and motions perpendicular to the velocity, with rotor and axial magnet, that gyroscopic
terms alone make stable and the normal form proves stable, and motions at the resonances 2:1 and 3:1. Runs start from each steady
motion with nudges in random directions that keep the momentum about the axis. The excursion of a motion is the range of theta over
the run, over its range in the first periods, the largest of all starts. The table has the median, the 95th percentile and the maximum
over the motions. Near a resonance excursions stay bounded for small nudges alone. Takes about two minutes.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping

import numpy as np
from scipy.optimize import brentq

import atlas
from atlas.flags import NonlinearStability, StabilityKind
from atlas.systems.base import Array, derived_values
from atlas.systems.satellite import SATELLITE

Points = dict[str, Array]
PERIODS = 3  # of the slow oscillation, over which the range of theta is the unit of excursions
NAMES = ("nonlinear_stability", "stability_kind", "frequency_1", "frequency_2")


def random_points(count: int, rng: np.random.Generator) -> Points:
    """Random motions of both families."""
    points = dict(SATELLITE.with_defaults({}))
    points = {name: np.full(count, value[0]) for name, value in points.items()}
    points |= {"C": rng.uniform(0.1, 1.95, count), "mu3": np.ones(count), "h3": 0.5 * rng.normal(size=count)}
    tilted = np.arange(count) % 2 == 1
    points["h1"] = np.where(tilted, 0.5 * rng.normal(size=count), 0.0)
    points["theta0"] = np.where(tilted, rng.uniform(0.1, 3.0, count), 0.0)
    points["psi0"] = np.where(tilted, np.pi / 2, 0.0)
    points["m"] = rng.uniform(-2, 2, count)
    balanced = SATELLITE.families["perp_velocity"].solve["k3"](points)
    momentum = rng.uniform(-4, 4, count)
    return points | {"k3": np.where(tilted, balanced, momentum - points["C"] * (points["m"] + 1))}


def theory(points: Mapping[str, Array]) -> dict[str, Array]:
    """Kinds of stability and frequencies of points, by name."""
    return derived_values(SATELLITE, NAMES, points, np.ones(len(points["A"])), lambda: None)


def gyroscopic(count: int) -> Points:
    """At most `count` points that gyroscopic terms alone make stable, and that are proved stable."""
    points = random_points(40 * count, np.random.default_rng(0))
    values = theory(points)
    proved = values["nonlinear_stability"] == NonlinearStability.ARNOLD_MOSER
    (chosen,) = np.nonzero((values["stability_kind"] == StabilityKind.GYROSCOPIC) & proved)
    return {name: column[chosen[:count]] for name, column in points.items()}


def resonant(ratio: int, sigma: float, low: float, high: float, tilted: bool = False) -> Points:
    """A motion with this ratio of frequencies; low, high: limits of the momentum of a cylindrical motion, or of the tilt."""

    def at(value: float) -> Points:
        points = dict(SATELLITE.with_defaults({"C": sigma}))
        if not tilted:
            return points | {"m": np.array([value / sigma - 1])}
        points |= {"theta0": np.array([value]), "psi0": np.array([np.pi / 2])}
        return points | {"k3": SATELLITE.families["perp_velocity"].solve["k3"](points)}

    def excess(value: float) -> float:
        values = theory(at(value))
        return float(values["frequency_1"][0] / values["frequency_2"][0] - ratio)

    return at(brentq(excess, low, high, xtol=1e-14))


def excursions(points: Mapping[str, Array], duration: float, nudge: float, starts: int) -> Array:
    """Range of theta over the run, over the range in the first periods, the largest of several starts, (points,)."""
    directions = np.random.default_rng(1).normal(size=(starts, 4))
    directions *= nudge / np.linalg.norm(directions, axis=1)[:, None]
    slow = np.tile(theory(points)["frequency_2"], starts)
    theta, psi, theta_rate, psi_rate = directions.repeat(len(points["A"]), axis=0).T
    start = {name: np.tile(column, starts) for name, column in points.items()}
    # m, so that the nudge keeps the momentum about the axis.
    axial = start["m"] + start["Omega"] * np.cos(start["theta0"])
    start |= {
        "theta0": start["theta0"] + theta,
        "psi0": start["psi0"] + psi,
        "theta_dot0": theta_rate,
        "n": psi_rate,
    }
    start["m"] = axial - (start["Omega"] + start["n"]) * np.cos(start["theta0"])
    ranges = []
    for length in (PERIODS * 2 * np.pi / slow, duration):
        ds = atlas.label_points(
            "satellite",
            start,
            duration=length,
            method="rk8",
            tolerance=1e-8,
            variables=["theta_min", "theta_max"],
        )
        ranges.append((ds.theta_max - ds.theta_min).values)
    return (ranges[1] / ranges[0]).reshape(starts, -1).max(0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, default=200)
    parser.add_argument("--duration", type=float, default=1e4)
    parser.add_argument(
        "--nudges", type=float, nargs="+", default=[0.05, 0.01, 0.003], help="rad, and rad per time unit"
    )
    parser.add_argument(
        "--starts", type=int, default=4, help="of each random motion; six times as many at resonances"
    )
    options = parser.parse_args()
    rows = {"random": gyroscopic(options.points)}
    for ratio, sigma, low, high in (
        (2, 0.6, -2.3, -1.7), (3, 0.6, -3.2, -2.5), (3, 0.95, -2.4, -1.8), (3, 1.05, 0.3, 0.6), (3, 1.2, -1.2, -0.8),
        (3, 1.07, -2.0, -1.5),
    ):  # fmt: skip
        rows[f"cylindrical {ratio}:1, C/A = {sigma}"] = resonant(ratio, sigma, low, high)
    rows["perp_velocity 2:1, C/A = 1.9"] = resonant(2, 1.9, 0.6, 0.79, tilted=True)
    print(f"{'motions':30s} {'verdict':20s} nudge  points  median     95 %  largest")
    for name, points in rows.items():
        verdict = NonlinearStability(int(theory(points)["nonlinear_stability"][0])).name.lower()
        starts = options.starts * (1 if name == "random" else 6)
        for nudge in options.nudges:
            ratio = excursions(points, options.duration, nudge, starts)
            middle, high, largest = np.quantile(ratio, [0.5, 0.95, 1.0])
            print(
                f"{name:30s} {verdict:20s} {nudge:<6g} {ratio.size:5d} {middle:8.3f} {high:8.3f} {largest:8.3f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
