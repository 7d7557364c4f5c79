"""Labels proved for every duration, compared with long runs, and the share of steady runs whose label is proved.

python scripts/benchmarks/bench_proofs.py [--points 2500] [--duration 1e4] [--seed 0] [--figure docs/labels_proofs.svg]

Random bodies of four kinds, POINTS of each, start from steady motions whose own labels are proved, with nudges of random direction
and size. About a quarter of the satellites, and all tops, have a minimum of the energy.
"""

from __future__ import annotations

import argparse

import numpy as np

import atlas
from atlas.extensions.equilibria import algebra

TOLERANCE = 1e-3
ANGLES, RATES = ("theta0", "psi0", "phi0"), ("theta_dot0", "n", "m")
SIZES = -5.0, -2.0  # decades of nudges, rad and rad per time unit
BINS = 12


def bodies(rng, count):
    """Random moments of inertia, (3, count)."""
    x = rng.dirichlet((2, 2, 2), count).T + 0.05
    return 2 * (x.sum(0) - x)


def attitudes(rng, count):
    """Random directions alpha and gamma at right angles, (count, 3)."""
    q = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
    return q[:, 0], q[:, 1]


def satellites(rng, count):
    """Random attitudes of satellites, made relative equilibria by the choice of the rotor, Omega = 1."""
    alpha, gamma = attitudes(rng, count)
    # Equilibrium needs beta.I alpha = 0: the moments are 1 + s v.
    v = np.cross(np.ones(3), np.cross(gamma, alpha) * alpha)
    inertia = 1 + rng.uniform(-0.3, 0.3, (count, 1)) * v / np.abs(v).max(1)[:, None]
    torque = 3 * np.cross(alpha, inertia * alpha) - np.cross(gamma, inertia * gamma)
    rotor = np.cross(torque, gamma) + rng.normal(size=(count, 1)) * gamma
    angles = algebra.attitudes(algebra.frames_of(alpha, gamma))
    return dict(zip(("A", "B", "C", "k1", "k2", "k3"), [*inertia.T, *rotor.T], strict=True)) | {
        k: angles[k] for k in ANGLES
    }


def symmetric_satellites(rng, count):
    """Symmetric satellites that turn about the third axis, which is at right angles to the radius or to the velocity."""
    (A, _, C), theta, m = bodies(rng, count), rng.uniform(0.2, np.pi - 0.2, count), rng.normal(size=count)
    C, by_velocity = np.minimum(C, 1.9 * A), rng.random(count) < 0.5
    momentum = np.where(by_velocity, 4 * A - 3 * C, A) * np.cos(theta)
    k3 = momentum - C * (m + np.cos(theta))
    return {
        "A": A,
        "B": A,
        "C": C,
        "k3": k3,
        "m": m,
        "theta0": theta,
        "psi0": np.where(by_velocity, np.pi / 2, 0.0),
    }


def rotations(rng, count):
    """Random rotations of bodies about the vertical, made permanent by the choice of the centre of mass."""
    inertia, n, rotor = bodies(rng, count).T, rng.normal(size=(count, 1)), rng.normal(size=(count, 3))
    gamma, N = attitudes(rng, count)[0], 0.3 * rng.normal(size=(count, 1))
    centre = rng.normal(size=(count, 1)) * gamma - (n**2 - N) * inertia * gamma - n * rotor
    names = ("A", "B", "C", "l1", "l2", "l3", "x0", "y0", "z0", "N", "n")
    points = dict(zip(names, [*inertia.T, *rotor.T, *centre.T, N[:, 0], n[:, 0]], strict=True))
    return points | {
        "Mg": 1.0,
        "theta0": np.arccos(gamma[:, 2]),
        "phi0": np.arctan2(gamma[:, 0], gamma[:, 1]),
    }


def tops(rng, count):
    """Random precessions of symmetric tops, made regular by the choice of the rotor."""
    (A, _, C), theta = bodies(rng, count), rng.uniform(0.2, np.pi - 0.2, count)
    m, z0, N = rng.normal(size=(3, count)) * np.array([[3], [1], [0.3]])
    n = rng.choice([-1, 1], count) * rng.uniform(0.3, 2.0, count)
    C = np.minimum(C, 1.9 * A)
    l3 = -((C - A) * (n**2 - N) * np.cos(theta) + z0) / n - C * m
    return {"A": A, "B": A, "C": C, "l3": l3, "z0": z0, "N": N, "Mg": 1.0, "theta0": theta, "n": n, "m": m}


KINDS = {
    "satellites with a rotor": ("satellite", satellites),
    "symmetric satellites": ("satellite", symmetric_satellites),
    "permanent rotations about a fixed point": ("fixed_point", rotations),
    "tops": ("fixed_point", tops),
}


def main() -> None:
    parser = argparse.ArgumentParser(description="proved labels against long runs")
    parser.add_argument("--points", type=int, default=2500, help="nudged starts of each kind")
    parser.add_argument("--duration", type=float, default=1e4)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--figure", help="file of the figure")
    options = parser.parse_args()
    rng, edges, shares = np.random.default_rng(options.seed), np.linspace(*SIZES, BINS + 1), {}
    settings = {"rate_tolerance": TOLERANCE, "method": "rk8", "tolerance": 1e-4}
    for kind, (system, make) in KINDS.items():
        points = make(rng, 8 * options.points)
        exact = atlas.label_points(system, points, duration=1.0, variables=["label_proof"], **settings)
        chosen = np.flatnonzero(exact["label_proof"])[: options.points]
        points = {
            name: np.broadcast_to(value, exact.sizes["point"])[chosen] for name, value in points.items()
        }
        decade, nudge = rng.uniform(*SIZES, chosen.size), rng.normal(size=(6, chosen.size))
        nudge = 10**decade * nudge / np.linalg.norm(nudge, axis=0)
        points |= {
            name: points.get(name, 0.0) + value for name, value in zip((*ANGLES, *RATES), nudge, strict=True)
        }
        names = ["label", "label_proof", "predicted", "proof_bound"]
        ds = atlas.label_points(system, points, duration=options.duration, variables=names, **settings)
        label, proof = ds["label"].values, ds["label_proof"].values > 0
        measured, stays = np.isin(label, (1, 2, 3)), np.isin(label, (1, 2))
        wrong = proof & measured & (label != ds["predicted"].values)
        print(
            f"{kind}: {chosen.size} starts, {measured.sum()} measured, {stays.sum()} stay, {(proof & measured).sum()} proved"
            f" and measured, {(proof & stays).sum() / max(stays.sum(), 1):.3f} of those that stay are proved, {wrong.sum()} contradictions",
            flush=True,
        )
        place = np.digitize(decade, edges) - 1
        stay, proved = (np.bincount(place[where], minlength=BINS) for where in (stays, stays & proof))
        shares[kind] = np.where(stay >= 10, proved / np.maximum(stay, 1), np.nan)
    if options.figure:
        import matplotlib.pyplot as plt

        figure, axes = plt.subplots(figsize=(6.0, 3.2), layout="constrained")
        for (kind, share), style in zip(shares.items(), ("-o", "--s", "-.^", ":D"), strict=True):
            axes.semilogx(10 ** (0.5 * (edges[1:] + edges[:-1])), share, style, label=kind, markersize=4)
        axes.set(
            xlabel="size of the nudge, rad and rad per time unit",
            ylabel="share proved of those that stay",
            ylim=(-0.02, 1.02),
        )
        axes.legend(frameon=False, fontsize="small")
        figure.savefig(options.figure, metadata={"Date": None})


if __name__ == "__main__":
    main()
