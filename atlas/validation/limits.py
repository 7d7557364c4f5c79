"""Stability limits and constraint errors of the methods, observed with the kernels that users run."""

from __future__ import annotations

import numpy as np

from .. import systems
from ..engine.ensemble import Ensemble
from ..engine.specialization import kernel
from ..engine.tableaux import METHODS, Method
from ..scene.tables import point_columns
from ..systems.base import Array, Points, System


def _final_states(system: System, method: str, points: Points, step_size: Array, steps: int) -> Array:
    """States after so many steps, (states, points)."""
    count = np.full(step_size.size, steps)
    return Ensemble.of(system, points).final_states(kernel(system, method), count, step_size)


def observed_stability(method: Method, steps: int = 16_000) -> dict[str, float]:
    """Largest stable y = (angular frequency) x (step) of two motions that contain one frequency each.

    A free spherical body: gamma turns in it at |w| ("turning"). A spherical body with a rotor and small w: w
    turns about the rotor at l3 / A ("nutation"). The values of y are on a grid of relative distance 1e-4.

    steps: a y is stable if the amplitude has not grown after so many steps. Returns y by "turning" and
    "nutation", rad; in theory both are `method.stability`.
    """
    system = systems.get("fixed_point")
    y = method.stability * np.linspace(0.95, 1.05, 1025)
    body = {"A": 1.0, "B": 1.0, "C": 1.0, "theta0": 1.0, "phi0": np.zeros(y.size)}
    starts = {
        # parameters, rows of the state that turn, their amplitude
        "turning": ({"m": 1.0}, slice(3, None), 1.0),
        "nutation": ({"l3": 1.0, "theta_dot0": 1e-9}, slice(2), 1e-9),
    }
    largest = {}
    for name, (start, rows, amplitude) in starts.items():
        points, _ = point_columns(system, body | start)
        with np.errstate(all="ignore"):
            vector = _final_states(system, method.name, points, y, steps)[rows] / amplitude
            stable = (vector**2).sum(0) <= 1.0
        largest[name] = float(y[stable].max())
    return largest


def constraint_bound(method: Method, y: float, steps: int) -> float:
    """Largest expected change of |gamma| over a run of a body that turns by y radians a step.

    A turn at constant rate multiplies the turning part by |R(i y)| each step, with R the stability function
    of the method: 1 - dissipation y^p to leading order (rk4: y^6 / 144). Rounding adds at most one unit of the
    last place a step.
    """
    return steps * (method.dissipation * y**method.dissipation_order + 2.0**-53)


def constraint_change(system: System, method: Method, points: Points, y: float, steps: int) -> Array:
    """Largest change of the constraints of the state over a run.

    y: length of a step times the frequency bound of the point, rad. Returns largest of abs(|gamma| - 1) and,
    for the satellite, abs(|alpha| - 1) and abs(alpha.gamma).
    """
    state = _final_states(system, method.name, points, y / system.frequency_bound(points), steps)
    unit = state[3:].reshape(-1, 3, state.shape[1])
    changes = [np.abs(np.sqrt((vector**2).sum(0)) - 1) for vector in unit]
    if len(unit) == 2:
        changes.append(np.abs((unit[0] * unit[1]).sum(0)))
    return np.asarray(np.max(changes, axis=0))


def limits(*, steps: int = 10_000_000) -> list[tuple[str, ...]]:
    """Limits of every method in theory and as observed in runs of `steps` steps.

    Returns rows of a table, the first one its heading.
    """
    satellite = systems.get("satellite")
    tumbling, _ = point_columns(satellite, {"A": 0.9, "B": 1.1, "k1": 0.2, "theta0": 0.7, "n": 0.5, "m": 0.9})
    turning, _ = point_columns(satellite, {"C": 1.0, "Omega": 0.0, "theta0": 1.0, "m": 1.0})
    turning_bound = float(satellite.frequency_bound(turning)[0])  # the body turns at rate 1
    rows: list[tuple[str, ...]] = [
        ("method", "largest stable y, theory", "turning", "nutation", f"loss of |gamma| in {steps:.0e} steps of",
         "theory", "free turn", "tumbling satellite")
    ]  # fmt: skip
    for method in METHODS.values():
        observed = observed_stability(method)
        y = 0.02 if method.order == 4 else 0.2
        rows.append((
            method.name, f"{method.stability:.5f}", f"{observed['turning']:.4f}", f"{observed['nutation']:.4f}",
            f"y = {y:g}", f"{constraint_bound(method, y, steps):.1e}",
            f"{constraint_change(satellite, method, turning, y * turning_bound, steps)[0]:.1e}",
            f"{constraint_change(satellite, method, tumbling, y, steps)[0]:.1e}",
        ))  # fmt: skip
    return rows
