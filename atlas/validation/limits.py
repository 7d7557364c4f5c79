"""Stability limits and constraint errors of the methods, measured in the kernels."""

from __future__ import annotations

import numpy as np

from .. import systems
from ..engine import blocks
from ..engine.tableaux import METHODS, Method
from ..label.pipeline import kernel
from ..scene.tables import point_columns
from ..systems.base import Array, Points, System

# Limits of the methods, measured in the kernels.


def _end(system: System, method: str, points: Points, length: Array, count: int) -> Array:
    """States after `count` steps, (state, points)."""
    state = np.ascontiguousarray(system.initial_state(points))
    constants = np.ascontiguousarray(system.constants(points))
    scales = np.zeros((len(system.equations.INTEGRALS), length.size))
    each, stride = np.full(length.size, count), np.full(length.size, min(count, 16))
    blocks.integrate(
        kernel(system, method), blocks.pack_blocks(each, stride), length, state, constants, scales, 1e-5
    )
    return state


def observed_stability(method: Method, steps: int = 16_000) -> dict[str, float]:
    """Largest stable y = w h of the body's turning and of nutation, each in a motion that has it alone.

    Turning: a free spherical body, gamma turns in it at |w|. Nutation: a spherical body with a rotor,
    its small w turns about the rotor at l3 / A. Found on a grid of relative distance 1e-4 or less.
    """
    system = systems.get("fixed_point")
    y = method.stability * np.linspace(0.95, 1.05, 1025)
    body = {"A": 1.0, "B": 1.0, "C": 1.0, "theta0": 1.0, "phi0": np.zeros(y.size)}
    found = {}
    for name, start in (("turning", {"m": 1.0}), ("nutation", {"l3": 1.0, "theta_dot0": 1e-9})):
        points, _ = point_columns(system, body | start)
        with np.errstate(all="ignore"):
            state = _end(system, method.name, points, y, steps)
            size = (state[3:] if name == "turning" else state[:2]) / (1.0 if name == "turning" else 1e-9)
            stable = (size**2).sum(0) <= 1.0
        found[name] = float(y[stable].max())
    return found


def constraint_bound(method: Method, y: float, steps: int) -> float:
    """Largest expected change of |gamma| over a run of a body that turns by y radians a step.

    A turn at constant rate multiplies the turning part by |R(i y)| each step, 1 - damping y^p to
    leading order (rk4: y^6 / 144); rounding adds at most one unit of the last place a step.
    """
    return steps * (method.damping * y**method.damping_order + 2.0**-53)


def constraint_change(system: System, method: Method, points: Points, y: float, steps: int) -> Array:
    """Largest change of |gamma| (and |alpha|, alpha.gamma of the satellite) after so many steps, (points,).

    Steps of y over the frequency bound of each point.
    """
    state = _end(system, method.name, points, y / system.frequency_bound(points), steps)
    unit = state[3:].reshape(-1, 3, state.shape[1])
    changes = [np.abs(np.sqrt((vector**2).sum(0)) - 1) for vector in unit]
    if len(unit) == 2:
        changes.append(np.abs((unit[0] * unit[1]).sum(0)))
    return np.asarray(np.max(changes, axis=0))


def limits(*, steps: int = 10_000_000) -> list[tuple[str, ...]]:
    """Table of limits as text, the first row the heading: theory, what was observed, long runs of `steps`."""
    satellite = systems.get("satellite")
    tumbling, _ = point_columns(satellite, {"A": 0.9, "B": 1.1, "k1": 0.2, "theta0": 0.7, "n": 0.5, "m": 0.9})
    rows: list[tuple[str, ...]] = [
        ("method", "largest stable y, theory", "turning", "nutation", f"loss of |gamma| in {steps:.0e} steps of",
         "theory", "free turn", "tumbling satellite")
    ]  # fmt: skip
    turn, _ = point_columns(satellite, {"C": 1.0, "Omega": 0.0, "theta0": 1.0, "m": 1.0})
    for method in METHODS.values():
        observed = observed_stability(method)
        y = 0.02 if method.order == 4 else 0.2
        rows.append((
            method.name, f"{method.stability:.5f}", f"{observed['turning']:.4f}", f"{observed['nutation']:.4f}",
            f"y = {y:g}", f"{constraint_bound(method, y, steps):.1e}",
            f"{_free_turn(satellite, method, turn, y, steps):.1e}",
            f"{constraint_change(satellite, method, tumbling, y, steps)[0]:.1e}",
        ))  # fmt: skip
    return rows


def _free_turn(system: System, method: Method, turn: Points, y: float, steps: int) -> float:
    """The same of a body that turns at rate 1 exactly: its bound is larger, so its step is given."""
    return float(
        constraint_change(system, method, turn, y * float(system.frequency_bound(turn)[0]), steps)[0]
    )
