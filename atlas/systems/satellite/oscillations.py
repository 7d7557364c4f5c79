"""Frequencies of small oscillations about steady motions of the satellite, and their stability by energy.

Both concern a body at rest in the orbital frame. A body that turns about an axis of symmetry, with rotor and magnet along
it, is the same as one at rest with the rotor k_i + I_i u_i, u the rotation relative to the frame: the moment I_i enters the
motion of the axis only through the constant momentum I_i w_i + k_i. Other turning bodies have periodic linear equations, whose
frequencies are defined up to multiples of the rate of rotation: they have none here.

The Jacobi integral is xi'.I xi' / 2 + W, W the amended potential (`Bodies.potential`), so that an equilibrium is stable
by energy where the Hessian of W is positive definite (Lagrange, Dirichlet). With the momentum about an axis of symmetry as
a second integral the condition is that on its level: xi_i is ignorable, and W is replaced by W + I_i (Omega (gamma_i - gamma_i0))^2 / 2
(Routh, Rumyantsev). Damping destroys this momentum and leaves W as it is. The frequencies are those without damping.
P. C. Hughes, Spacecraft Attitude Dynamics (1986), chapters 9 and 10.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...flags import EnergyStability
from ..base import Array, Flags, Mask, Points, subset
from .initial import initial_state
from .stability import Bodies

# Of exponents and of eigenvalues of the Hessian: below this, relative to their scale, they are zero. A double exponent 0
# has the square root of rounding as its error.
_ZERO = 1e-6


def _at_rest(points: Points) -> tuple[dict[str, Array], Array, Mask]:
    """Equivalent points at rest in the orbital frame, their axis of symmetry (-1: none), and where these exist.

    The points are steady motions, in arrays (points,).
    """
    state = initial_state({**points, "theta_dot0": np.zeros_like(points["A"])})
    u = state[:3] - points["Omega"] * state[6:]
    rate = np.abs(points["Omega"]) + np.abs(points["n"]) + np.abs(points["m"])
    small = np.abs(u) <= 1e-12 * rate
    rest = small.all(0)
    axis = np.full(rate.shape, -1)
    moments = [points[name] for name in "ABC"]
    no_field = (points["h1"] == 0) & (points["h3"] == 0)
    result = {**points, "n": np.zeros_like(rate), "m": np.zeros_like(rate), "theta_dot0": np.zeros_like(rate)}
    for i in (0, 1, 2):
        j, l = (i + 1) % 3, (i + 2) % 3
        symmetric = (moments[j] == moments[l]) & small[j] & small[l]
        for other in (j + 1, l + 1):
            symmetric &= (points[f"k{other}"] == 0) & ((points[f"mu{other}"] == 0) | no_field)
        axis[symmetric & (axis < 0)] = i
        turning = symmetric & ~small[i]
        name = f"k{i + 1}"
        result[name] = np.where(turning, points[name] + moments[i] * u[i], points[name])
    return result, axis, rest | (axis >= 0)


def _balanced(points: Points, candidates: Mask) -> NDArray[np.int64]:
    """Those of the candidates at which no torque acts on the body at rest."""
    where = np.flatnonzero(candidates)
    with np.errstate(all="ignore"):
        bodies, alpha, gamma, _ = _frames(subset(points, where))
        gradient, hessian = bodies.gradient(alpha, gamma)
        scale = np.abs(bodies.Omega) ** 2 + np.abs(hessian).max((1, 2))[:, None]
        return where[(np.abs(gradient) <= _ZERO * scale).all(1)]


def _frames(points: Points) -> tuple[Bodies, Array, Array, Array]:
    """Bodies in units of a rate, alpha and gamma (points, 3), and the rate."""
    state = np.moveaxis(initial_state(points), 0, -1)
    rate = np.where(points["Omega"] == 0, 1.0, points["Omega"])
    return Bodies(points, rate), state[:, 3:6], state[:, 6:], rate


def frequencies(points: Points, flags: Flags) -> Array:
    """Frequencies of the small oscillations about steady motions.

    points: 1-D arrays of one length; flags: families, as identify_family gives them. Returns rad per time
    unit, the largest first; nan for exponents that are 0 or have a real part, off every family, and where the
    linear equations are periodic, (points, 3).
    """
    result = np.full((flags.size, 3), np.nan)
    resting, _, exists = _at_rest(points)
    where = _balanced(resting, exists & (flags > 0))
    with np.errstate(all="ignore"):
        bodies, alpha, gamma, rate = _frames(subset(resting, where))
        matrix = bodies.linearised(bodies.Omega * gamma, alpha, gamma)
    finite = np.isfinite(matrix).all((1, 2))
    where, rate = where[finite], rate[finite]
    exponents = np.linalg.eigvals(matrix[finite])
    scale = np.abs(exponents).max(-1, keepdims=True)
    oscillating = (exponents.imag > _ZERO * scale) & (np.abs(exponents.real) <= _ZERO * scale)
    values = np.where(oscillating, exponents.imag, np.nan) * rate[:, None]
    result[where] = -np.sort(-values, axis=-1)[:, :3]  # nan last
    return result


def energy_stability(points: Points, flags: Flags) -> tuple[Flags, Mask]:
    """Whether steady motions are stable by the energy; as `systems.oscillations.oscillation_variables` needs it."""
    result = np.full(flags.shape, EnergyStability.UNKNOWN, np.int8)
    resting, axis, exists = _at_rest(points)
    where = _balanced(resting, exists & (flags > 0))
    with np.errstate(all="ignore"):
        bodies, alpha, gamma, _ = _frames(subset(resting, where))
        hessian = bodies.gradient(alpha, gamma)[1]
    finite = np.isfinite(hessian).all((1, 2))
    where, hessian, axis = where[finite], hessian[finite], axis[where[finite]]
    hessian = 0.5 * (hessian + np.swapaxes(hessian, 1, 2))
    scale = np.abs(hessian).max((1, 2))
    for i in (0, 1, 2):
        members = np.flatnonzero(axis == i)
        tilt = np.cross(np.eye(3)[i], gamma[finite][members])  # delta gamma_i = tilt . xi
        stiffness = (bodies.inertia[:, i] * bodies.Omega[:, 0] ** 2)[finite][members]
        stiffness = np.where(bodies.damping[finite][members] > 0, 0.0, stiffness)
        reduced = hessian[members] + stiffness[:, None, None] * tilt[:, :, None] * tilt[:, None, :]
        reduced[:, i], reduced[:, :, i] = 0.0, 0.0
        reduced[:, i, i] = scale[members]  # the ignorable direction
        hessian[members] = reduced
    least = np.linalg.eigvalsh(hessian)[:, 0]
    decided = np.where(least > 0, EnergyStability.YES, EnergyStability.NO)
    degenerate = np.zeros(flags.shape, bool)
    degenerate[where] = np.abs(least) <= _ZERO * scale
    result[where] = np.where(degenerate[where], EnergyStability.UNKNOWN, decided)
    return result, degenerate
