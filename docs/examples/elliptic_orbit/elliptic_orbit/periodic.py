"""The odd solutions of period 2 pi, by shooting along a path in K or in e, and their stability by Floquet's theory."""

from functools import lru_cache

import numpy as np
from scipy.integrate import solve_ivp

from atlas.flags import Stability

STEPS = 16  # of the path
NODES = 24  # of half an orbit along it


def half_turn(e, K, rate, rtol=None):
    """psi at nu = pi from psi = 0, and the matrix (2, 2, points) that takes a change of (psi, psi') there; roughly without rtol."""

    def slope(nu, flat):
        psi, v, a, b, c, d = flat.reshape(6, -1)
        push, w = 2 * e * np.sin(nu), 1 + e * np.cos(nu)
        stiffness = 3 * K * np.cos(2 * psi)
        forces = (
            push * (1 + v) - 1.5 * K * np.sin(2 * psi),
            push * c - stiffness * a,
            push * d - stiffness * b,
        )
        return np.concatenate([v, forces[0] / w, c, d, forces[1] / w, forces[2] / w])

    zero, one = np.zeros_like(rate), np.ones_like(rate)
    end = np.concatenate([zero, rate, one, zero, zero, one])
    if rtol is not None:
        end = solve_ivp(slope, (0, np.pi), end, "DOP853", rtol=rtol, atol=rtol).y[:, -1]
    else:
        h = np.pi / NODES
        for nu in h * np.arange(NODES):
            k1 = slope(nu, end)
            k2 = slope(nu + h / 2, end + h / 2 * k1)
            k3 = slope(nu + h / 2, end + h / 2 * k2)
            end = end + h / 6 * (k1 + 2 * k2 + 2 * k3 + slope(nu + h, end + h * k3))
    psi, _, *matrix = end.reshape(6, -1)
    return psi, np.reshape(matrix, (2, 2, -1))


def newton(e, K, rate, rtol=None):
    psi, matrix = half_turn(e, K, rate, rtol)
    change = np.clip(-psi / matrix[0, 1], -0.5, 0.5)
    return np.clip(rate + change, -3, 3), change, matrix


def odd_solution(points):
    """Rate at the pericentre and trace over an orbit, nan where the path meets a fold; |trace| < 2: stable."""
    columns = (np.ravel(points[name]).astype(float) for name in ("e", "K", "branch"))
    rate, trace = _solved(*(column.tobytes() for column in columns))
    return rate.reshape(np.shape(points["e"])), trace.reshape(np.shape(points["e"]))


@lru_cache(8)
def _solved(*columns):
    e, K, branch = (np.frombuffer(column) for column in columns)
    circular = branch == 1
    rate = np.where(circular, 0.0, (1 - e * e) ** 1.5 / (1 + e) ** 2 - 1)  # a sphere does not turn
    sign = np.sign(newton(np.where(circular, 0.0, e), np.where(circular, K, 0.0), rate)[2][0, 1])
    exists, last = np.ones(e.size, bool), rate
    for share in np.linspace(0, 1, STEPS + 1)[1:]:
        at = np.where(circular, share * e, e), np.where(circular, K, share * K)
        last, rate = rate, 2 * rate - last
        for _ in range(2):
            rate, _, matrix = newton(*at, rate)
        exists &= np.sign(matrix[0, 1]) == sign  # at a fold the sign changes
        rate = np.where(exists, rate, 0.0)
    for _ in range(3):
        rate, change, ((a, b), (c, d)) = newton(e, K, rate, 1e-13)
    exists &= (np.sign(b) == sign) & (np.abs(change) < 1e-9)
    # The equation is the same for -nu and -psi: the second half of the orbit is the first, reflected.
    trace = 2 * (a * d + b * c) / (a * d - b * c)
    return np.where(exists, rate, np.nan), np.where(exists, trace, np.nan)


def stability(points, *_):
    """Values of flags.Stability."""
    trace = odd_solution(points)[1]
    stable = np.where(np.abs(trace) < 2, Stability.STABLE, Stability.UNSTABLE)
    return np.where(np.isnan(trace), Stability.UNKNOWN, stable).astype(np.int8)
