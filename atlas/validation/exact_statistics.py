"""Exact statistics of the runs of exact motions, by quadrature.

Nothing here uses the statistics of the engine, so that these values check them.
"""

from __future__ import annotations

import numpy as np

from ..systems.base import Array
from .exact import EulerMotion, Motion

# Nodes and weights of an interval of the quadrature. Intervals are halved until the sum over the halves differs by
# no more than QUADRATURE_RTOL of the integral; no motion needs MAX_INTERVALS intervals.
GAUSS_NODES, GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(16)
QUADRATURE_RTOL, MAX_INTERVALS = 1e-13, 100_000


def statistics(motion: Motion, duration: float) -> dict[str, float]:
    """Exact statistics of a run over [0, duration], not only over whole periods.

    duration: in time units. Returns theta_dot_rms, theta_dot_std, psi_dot_mean, psi_dot_std, phi_dot_mean,
    phi_dot_std, normal_rate_mean, normal_rate_std (rad per time unit), theta_min and theta_max (rad), as the
    registry of variables defines them; nan for psi' and phi' on the vertical.
    """
    turns = int(duration // motion.period)
    first = motion.period if turns else duration
    time, weight = _quadrature(motion, first)
    theta = _theta_at_turns(motion, np.concatenate([[0.0], time, [first]]))
    if turns:  # every whole period counts alike; then the rest
        rest = _quadrature(motion, duration - turns * motion.period)
        time, weight = np.concatenate([time, rest[0]]), np.concatenate([turns * weight, rest[1]])
    result = moments(motion(time), weight / duration)
    return result | {"theta_min": float(theta.min()), "theta_max": float(theta.max())}


def moments(motion: EulerMotion, weight: Array) -> dict[str, float]:
    """Rms, standard deviations and means of the rates of a run, without the mean of theta'.

    motion: at the nodes of a quadrature, shape (nodes,). weight: quadrature weights; their sum is 1,
    (nodes,). Returns as `statistics`, without theta_min and theta_max.
    """
    result = {"theta_dot_rms": float(np.sqrt(weight @ motion.theta_dot**2))}
    for name in ("theta_dot", "psi_dot", "phi_dot", "normal_rate"):
        rate = getattr(motion, name)
        mean = float(weight @ rate)
        result |= {f"{name}_mean": mean, f"{name}_std": float(np.sqrt(weight @ (rate - mean) ** 2))}
    del result["theta_dot_mean"]
    return result


def _quadrature(motion: Motion, duration: float) -> tuple[Array, Array]:
    """Nodes in ascending order, and weights, that integrate the rates and their squares over [0, duration]."""
    edges = np.linspace(0.0, duration, 9 + int(motion.rate * duration))
    while edges.size <= MAX_INTERVALS:
        middle = 0.5 * (edges[:-1] + edges[1:])
        halves = np.sort(np.concatenate([edges, middle]))
        whole, parts = _integrals(motion, edges), _integrals(motion, halves)
        parts = parts[:, ::2] + parts[:, 1::2]
        # Rates are compared with the fastest one; a variation of 1e-6 of that is still measured.
        scale = parts.sum(1) + (1e-6 * motion.rate) ** 2 * duration
        scale[:4] = motion.rate * duration
        bad = (np.abs(whole - parts) > QUADRATURE_RTOL * scale[:, None]).any(0)
        if not bad.any():
            length = np.diff(halves)
            time = halves[:-1, None] + 0.5 * length[:, None] * (1 + GAUSS_NODES)
            return time.ravel(), (0.5 * length[:, None] * GAUSS_WEIGHTS).ravel()
        edges = np.sort(np.concatenate([edges, middle[bad]]))
    raise ValueError("the quadrature over an exact motion does not converge")


def _integrals(motion: Motion, edges: Array) -> Array:
    """Integrals of the four rates and of their squares between neighbouring edges, (8, intervals)."""
    half = 0.5 * np.diff(edges)
    at_nodes = motion(edges[:-1, None] + half[:, None] * (1 + GAUSS_NODES))
    rates = np.nan_to_num([at_nodes.theta_dot, at_nodes.psi_dot, at_nodes.phi_dot, at_nodes.normal_rate])
    return np.concatenate([rates, rates**2]) @ GAUSS_WEIGHTS * half


def _theta_at_turns(motion: Motion, time: Array) -> Array:
    """theta at both ends of the times and where it has an extreme between two neighbouring times."""
    slope = motion(time).cos_theta_dot
    turns = np.flatnonzero(slope[:-1] * slope[1:] < 0)
    low, high, sign = time[turns], time[turns + 1], slope[turns]
    for _ in range(60):
        middle = 0.5 * (low + high)
        is_low = motion(middle).cos_theta_dot * sign > 0
        low, high = np.where(is_low, middle, low), np.where(is_low, high, middle)
    return motion(np.concatenate([time[[0, -1]], 0.5 * (low + high)])).theta
