"""Labels of random satellites that can be computed in two ways, and how many differ.

    python scripts/benchmarks/bench_label_checks.py [--points 20000] [--method rk4]

Slender bodies (C from 1e-3 to 0.1 of A): runs for labels only, which end early, are compared with whole runs. Bodies without an
orbit (Omega = 0) are compared with the same bodies as gyrostats about a fixed point, with Mg r_c = -h3 mu.
"""

from __future__ import annotations

import argparse

import numpy as np

from atlas import label_points
from atlas.flags import Label, Status

RATES = ("theta_dot_rms", "psi_dot_mean", "psi_dot_std", "phi_dot_mean", "phi_dot_std", "normal_rate_std")


def random_bodies(size: int, low: float, high: float) -> dict[str, np.ndarray]:
    """Random satellites with C between low and high times A; each rotor, magnet and rate is 0 at half of them."""
    rng = np.random.default_rng(0)
    names = ("k1", "k2", "k3", "mu1", "mu2", "mu3", "h3", "theta_dot0", "n", "m")
    points = {name: rng.normal(size=size) * rng.integers(0, 2, size) for name in names}
    C = np.exp(rng.uniform(np.log(low), np.log(high), size))
    B = 1 + np.minimum(C, 1.0) * rng.uniform(-0.9, 0.9, size) * rng.integers(0, 2, size)
    points |= {"A": np.ones(size), "B": B, "C": np.minimum(C, 0.99 * (1 + B))}
    theta = rng.uniform(0, np.pi, size) * rng.integers(0, 3, size).clip(0, 1)
    return points | {"theta0": theta, "phi0": rng.uniform(0, 6, size)}


def counts(label: np.ndarray) -> str:
    """Numbers of points with each label, in words."""
    numbers = np.bincount(label, minlength=len(Label))
    return ", ".join(
        f"{name} {count}" for name, count in zip(Label.meanings(), numbers, strict=True) if count
    )


def slender(size: int, method: str) -> None:
    """Compare runs for labels only with whole runs."""
    points, options = random_bodies(size, 1e-3, 0.1), {"duration": 5.0, "method": method}
    points["k3"] *= points["C"]  # a rotor as slow as the body
    whole = label_points("satellite", points, **options)
    only = label_points("satellite", points, variables=["label", "label_inertial", "status"], **options)
    differ = (whole["label"] != only["label"]) | (whole["label_inertial"] != only["label_inertial"])
    resolved = (whole["status"] == Status.OK) & (only["status"] == Status.OK)
    print(f"slender, {method}: {counts(whole['label'].values)}; labels-only runs differ at {int(differ.sum())},"
          f" {int((differ & resolved).sum())} of them resolved in both")  # fmt: skip


def no_orbit(size: int, method: str) -> None:
    """Compare satellites with Omega = 0 with gyrostats about a fixed point."""
    points, options = random_bodies(size, 0.2, 1.9), {"duration": 20.0, "method": method}
    first = label_points("satellite", points | {"Omega": 0.0}, **options)
    same = {name: points[name] for name in ("A", "B", "C", "theta0", "phi0", "theta_dot0", "n", "m")}
    same |= {f"l{i}": points[f"k{i}"] for i in (1, 2, 3)} | {"Mg": 1.0}
    same |= {f"{axis}0": -points["h3"] * points[f"mu{i}"] for i, axis in enumerate("xyz", 1)}
    second = label_points("fixed_point", same, **options)
    differ = (first["label"] != second["label"]).values
    resolved = (first["status"] == Status.OK).values & (second["status"] == Status.OK).values
    change = np.nanmax([np.abs(first[name] - second[name]).values[resolved] for name in RATES], axis=0)
    print(f"no orbit, {method}: {counts(first['label'].values)}; labels of the fixed point differ at {differ.sum()},"
          f" {(differ & resolved).sum()} of them resolved in both; rates differ by {np.median(change):.1e} (median),"
          f" {np.quantile(change, 0.99):.1e} (99 %)")  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--points", type=int, default=20_000)
    parser.add_argument("--method", default="rk4")
    arguments = parser.parse_args()
    slender(arguments.points, arguments.method)
    no_orbit(arguments.points, arguments.method)


if __name__ == "__main__":
    main()
