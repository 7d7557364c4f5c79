"""Labels and errors of satellites after many orbits, against closed forms.

    python scripts/benchmarks/bench_long_runs.py [--method rk8] [--orbits 1e5] [--tolerance 1e-8] [--only spherical]

Exact starts on stable steady motions of four families, and librations of 0.2 and 1.2 rad in the plane of the orbit.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from atlas import label_points
from atlas.extensions.studies import exact
from atlas.extensions.studies.plane_cases import PlaneMotion
from atlas.flags import Label
from atlas.scene.tables import point_columns
from atlas.systems import get

SATELLITE = get("satellite")
SPIN = np.linspace(0.2, 1.1, 4)
FAMILIES = {
    "cylindrical": {"C": 1.3, "m": SPIN},
    "perp_velocity": {"C": 0.7, "theta0": 0.8, "psi0": np.pi / 2, "m": SPIN},
    "perp_radius": {"C": 1.3, "theta0": 0.8, "m": SPIN},
    "spherical": {"C": 1.0, "n": 0.5, "theta0": 1.0, "m": SPIN},
}
LIBRATIONS = {"B": 1.3, "psi0": np.array([0.2, 1.2]), "k3": 0.5}


def true_rates(name: str, points: dict[str, np.ndarray], duration: float) -> dict[str, np.ndarray]:
    """Mean and standard deviation of the rate about the normal, by closed form."""
    if name == "planar libration":
        size = points["A"].size
        runs = [
            exact.statistics(exact.motion_of(SATELLITE, PlaneMotion, points, i), duration)
            for i in range(size)
        ]
        return {key: np.array([run[key] for run in runs]) for key in ("normal_rate_mean", "normal_rate_std")}
    mean = points["n"] + points["m"] * np.cos(points["theta0"])
    return {"normal_rate_mean": mean, "normal_rate_std": np.zeros_like(mean)}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--method", default="rk8")
    parser.add_argument("--orbits", type=float, default=1e5)
    parser.add_argument("--tolerance", type=float, default=1e-8)
    kinds = FAMILIES | {"planar libration": LIBRATIONS}
    parser.add_argument("--only", nargs="+", choices=kinds, default=list(kinds))
    options = parser.parse_args()
    duration = 2 * np.pi * options.orbits
    for name in options.only:
        points, _ = point_columns(SATELLITE, kinds[name])
        if name in FAMILIES and name != "cylindrical":
            points["k3"] = SATELLITE.families[name].solve["k3"](points)
        began = time.perf_counter()
        ds = label_points(
            "satellite", points, duration=duration, method=options.method, tolerance=options.tolerance, threads=1
        )  # fmt: skip
        seconds = time.perf_counter() - began
        error = [
            float(abs(ds[key] - value).max()) for key, value in true_rates(name, points, duration).items()
        ]
        truth = ds["predicted"] if name in FAMILIES else Label.DRIFTING
        print(
            f"{name:17} {int((ds['label'] == truth).sum())} of {ds.sizes['point']} labels right; largest errors: of the"
            f" mean rate {error[0]:.1e}, of its spread {error[1]:.1e}, theta' {float(ds['theta_dot_rms'].max()):.1e};"
            f" error_estimate {float(ds['error_estimate'].max()):.1e}, drift {float(ds['integral_drift'].max()):.1e};"
            f" {duration / float(ds['step'].min()):.1e} steps, {seconds:.0f} s"
        )


if __name__ == "__main__":
    main()
