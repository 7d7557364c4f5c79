"""Time of the satellite's theory for a million random points, on one core.

    python scripts/benchmarks/bench_catalogue.py [--points 1000000]

A third of the points start on no family, a third on motions of perp_velocity and a third on cylindrical motions, whose
stability has closed forms. Eigenvalues and multipliers are timed on fewer points.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from atlas.extensions.certificate.proofs import PROOFS
from atlas.label.plan import Plan
from atlas.label.theory import predict_runs
from atlas.scene.grid import Grid
from atlas.scene.model import Settings
from atlas.systems import get
from atlas.systems.base import families_of

SATELLITE = get("satellite")


def random_points(size: int, seed: int = 0) -> dict[str, np.ndarray]:
    """Random bodies and starts of order 1; a third on perp_velocity, a third on cylindrical without magnet."""
    rng = np.random.default_rng(seed)
    absent = ("damping", "drag1", "drag2", "drag3")  # torques that the paper does not have
    names = [name for name in SATELLITE.parameters if name not in absent]
    points = {name: rng.uniform(0.3, 1.3, size) for name in names} | dict.fromkeys(absent, np.zeros(size))
    points |= {name: rng.uniform(0.7, 1.3, size) for name in "ABC"}
    tilted, upright = np.arange(size) % 3 == 1, np.arange(size) % 3 == 2
    steady = tilted | upright
    points["B"] = np.where(steady, points["A"], points["B"])
    for name in ("k1", "k2", "mu1", "mu2", "theta_dot0"):
        points[name] = np.where(steady, 0.0, points[name])
    points["n"] = np.where(tilted, 0.0, points["n"])
    points["psi0"] = np.where(tilted, np.pi / 2, points["psi0"])
    points["k3"] = np.where(tilted, SATELLITE.families["perp_velocity"].solve["k3"](points), points["k3"])
    points["theta0"] = np.where(upright, 0.0, points["theta0"])
    points["mu3"] = np.where(upright, 0.0, points["mu3"])
    return points


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--points", type=int, default=1_000_000)
    count = parser.parse_args().points
    points = random_points(count)
    total = time.perf_counter()
    began = time.perf_counter()
    flags, _ = SATELLITE.identify_family(points)
    print(f"identify_family       {time.perf_counter() - began:7.2f} s for {count} points")
    began = time.perf_counter()
    stable, _ = SATELLITE.linear_stability(points, flags)
    print(
        f"linear_stability      {time.perf_counter() - began:7.2f} s, {np.bincount(stable, minlength=3)} unknown, stable, unstable"
    )
    print(f"together              {time.perf_counter() - total:7.2f} s")
    for name, family in families_of(SATELLITE).items():
        print(f"  {name}: {(flags == family.flag).sum()} points")

    settings, one = Settings(rate_tolerance=1e-5), np.ones(count)
    plan = Plan(SATELLITE, settings, in_machine_code=True)
    tile = Grid(points, points, np.zeros(count, np.int8), 50.0 * one, 1e-5 * one)
    tolerances = settings.at(tile.rate_tolerance).tolerances
    predict_runs(plan, tile.subset(slice(0, 3)))  # compiles
    PROOFS.proofs(SATELLITE, {k: v[:3] for k, v in points.items()}, tolerances.subset(slice(0, 3)), True)
    began = time.perf_counter()
    predict_runs(plan, tile)
    print(f"predictions           {time.perf_counter() - began:7.2f} s")
    began = time.perf_counter()
    PROOFS.proofs(SATELLITE, points, tolerances, True)
    print(f"proofs                {time.perf_counter() - began:7.2f} s")

    print_numeric_stability(min(count, 2000))


def print_numeric_stability(count: int) -> None:
    """Print the time of a point whose stability follows from eigenvalues, or from Floquet multipliers."""
    points = random_points(3 * count, 1)
    points = {name: values[:count] for name, values in points.items()}
    rest = ("n", "m", "theta_dot0", "mu1", "mu2", "mu3", "theta0", "psi0", "phi0")
    points |= {name: np.zeros(count) for name in rest}
    resting = points | {name: np.zeros(count) for name in ("k1", "k2")} | {"B": points["A"] + 0.1}
    turning = resting | {"B": resting["A"], "m": -resting["Omega"], "k1": points["k3"]}
    for name, case in (("eigenvalues", resting), ("multipliers", turning)):
        flags, _ = SATELLITE.identify_family(case)
        began = time.perf_counter()
        SATELLITE.linear_stability(case, flags)
        each = (time.perf_counter() - began) / flags.size
        print(
            f"{name}           {1e3 * each:7.3f} ms for each of {flags.size} points ({(flags > 0).sum()} steady)"
        )


if __name__ == "__main__":
    main()
