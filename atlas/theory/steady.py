"""Decide from the equations of motion whether a start is a steady motion, about which axes and at which rates.

The states of a body in a frame are an angular velocity w and vectors v at rest in the frame. They obey v' = v x u, where u is the
rotation relative to the frame and w - u is the rotation of the frame. A steady motion u = n nu + m s has an axis s at rest in the
body and an axis nu at rest in the frame. Seen from the body, nu turns about s at -m, so that u' = n m nu x s and u'' = m u' x s.

- If s is known, m = u'.(u x s) / |u x s|^2 and n nu = u - m s.
- If nu is known, n = u'.(nu x u) / |nu x u|^2 and m s = u - n nu.
- If neither is known, s is along u' x u''.

**Theorem.** Let the right-hand side be a polynomial of degree d in the states. Along a candidate for the motion, every state is
a trigonometric polynomial of degree 1 in each of the phases n t and m t. The residual is w' of the equations minus w' of the
candidate. It has degree d and is a sum over the frequencies k n + l m with |k|, |l| <= d. If n : m = p : q in lowest terms with
|p|, |q| <= 2 d, the motion is periodic and the residual has degree d (|p| + |q|) in the phase of the motion. It vanishes for all
time if and only if it vanishes at N = 2 d (|p| + |q|) + 1 equidistant instants, whose Fourier transform has condition 1. At any
other n : m no two frequencies coincide, and the residual must vanish on the whole torus of the phases. The line of direction
1 : 2 d + 1 then suffices. The numbers k + (2 d + 1) l differ, so that N = (2 d + 1)^2 instants decide. If n or m is 0, or every
vector is along nu, one phase is left and p or q is 0. Between the nodes the residual is at most 3.6 times the largest value at
the nodes for d = 2.

A ratio within RATIO of p : q counts as p : q. Runs up to a time of 1 / (RATIO n) cannot tell the ratios apart.

The residual counts as 0 if each component is at most TERM_ROUNDING times a sum. The sum has the magnitudes of all terms on the
right-hand side, and the magnitudes of the changes of the terms by errors of the states. A fast spin thus loosens only the test
of components whose terms contain the spin. Axes computed from derivatives have larger errors, because terms of u' cancel.
"""

from __future__ import annotations

import math
from enum import IntEnum

import numpy as np

from ..systems.steady import GATE, TERM_ROUNDING
from .generated import (
    DEGREE,
    PERIODS,
    derivatives,
    derivatives_change,
    frame_motion,
    magnitudes,
    rotate_all,
    turn_all,
)
from .point import (
    THIRD,
    Motion,
    Start,
    cross,
    cross_sum,
    dot,
    fmax,
    fmin,
    length,
    magnitude,
    minus,
    plus,
    rotate,
    scaled,
    unit,
)

# A difference of rates below this fraction of the rates is a rounding error.
UNIT_ERROR = 2.0**-51
RATIO = 1e-9
# Axes from derivatives have errors. The tolerance of the residual allows for errors below this multiple of rounding errors.
MAX_ERROR = 1e4
# A start is far from every steady motion if the first-order change of rates exceeds this many tolerances. Among 30 000 starts
# near steady motions, no start with a steady label had a change above 2.4.
FAR = 5.0
CANDIDATES = 4


class Existence(IntEnum):
    """Whether a start is a steady motion."""

    NEAR = 0  # neither EXACT nor surely FAR
    EXACT = 1  # a steady motion, as exactly as rounding allows
    FAR = 2  # rates vary by more than the tolerance


def steady_motion(w, vectors, constants, rates, bound, duration, rate_tolerance, angle_tolerance):
    """Return an Existence and the steady motion. A start that is not steady gets the motion about the third axis and the vertical.

    The argument `rates` is (sin theta, n, m) of System.steady_rates, and `bound` is the frequency bound.
    """
    start = start_on_axis(w, vectors, constants, rates)
    is_exact, motion = exact_motion(start, constants, rates, bound)
    if is_exact:
        return Existence.EXACT, motion
    change = departure(start, constants, motion, bound, duration, rate_tolerance, angle_tolerance)
    return Existence.FAR if change > FAR else Existence.NEAR, motion


def exact_motion(start, constants, rates, bound):
    """Return True and the motion if a start is steady within rounding, else False and the motion about e3 and the vertical."""
    about_third = motion_about_third(start, rates)
    if is_beside(start, about_third, bound) and is_steady(start, constants, about_third, bound, False):
        return True, about_third
    if abs(dot(start.u, start.acceleration)) <= GATE * length(start.u) * bound**2:
        second = second_derivative(start, constants)
        for which in range(CANDIDATES):
            motion = candidate(which, start, second, bound)
            # Rates far above the bound cancel in u and leave errors as large as u.
            near = fmax(abs(motion.m), abs(motion.n)) <= 8 * bound and is_beside(start, motion, bound)
            if near and is_steady(start, constants, motion, bound, True):
                return True, motion
    return False, about_third


def start_at(w, vectors, constants):
    slope, slopes = derivatives(w, vectors, constants)
    u, vertical = frame_motion(w, vectors, constants)
    frame, slip = minus(w, u), 0.0
    for i in range(len(vectors)):
        slip += length(minus(slopes[i], cross(vectors[i], u)))
    return Start(w, vectors, slip, u, frame, slope, minus(slope, cross(frame, u)), vertical)


def start_on_axis(w, vectors, constants, rates):
    """Return the start. If the third axis is vertical, transverse rates that are rounding errors of a fast precession become 0."""
    start, (sine, n, _) = start_at(w, vectors, constants), rates
    if abs(sine) <= TERM_ROUNDING and np.hypot(start.u[0], start.u[1]) <= TERM_ROUNDING * abs(n):
        return start_at((w[0] - start.u[0], w[1] - start.u[1], w[2]), vectors, constants)
    return start


def motion_about_third(start, rates):
    """Return the motion about the third axis and the vertical. Rates that are rounding errors of w become 0."""
    sine, n, m = rates
    g = start.vertical
    x, y, z = plus(magnitude(start.w), magnitude(start.frame))
    upright = abs(sine) <= TERM_ROUNDING and np.hypot(start.u[0], start.u[1]) <= UNIT_ERROR * abs(n)
    if upright or abs(n * sine) <= UNIT_ERROR * np.hypot(x, y):
        n, m = 0.0, start.u[2]
    if abs(m) <= UNIT_ERROR * (z + abs(n * g[2])):
        m = 0.0
    return Motion(THIRD, m, g, n)


def candidate(which, start, second, bound):
    """Return a candidate for the motion u = n nu + m s from u, u' and `second`, which is u''.

    The number `which` says what is assumed: 0 nu and s are along u, 1 nu is vertical, 2 s is the third axis, 3 none of these.
    """
    u, first, g = start.u, start.acceleration, start.vertical
    least = TERM_ROUNDING * (length(u) + length(start.frame))
    if which == 0:
        axis = unit(u, THIRD)
        return Motion(axis, length(u), axis, 0.0)
    if which == 1:
        n = rate_about(cross(g, u), u, first, least)
        rest = minus(u, scaled(n, g))
        s, m, nu = unit(rest, THIRD), length(rest), g
    else:
        s = THIRD
        if which == 3:
            s = unit(cross(second, first), THIRD)
            if not length(cross(s, THIRD)) > GATE:
                s = (np.nan, np.nan, np.nan)
        m = rate_about(cross(u, s), u, first, least)
        rest = minus(u, scaled(m, s))
        nu, n = unit(rest, g), length(rest)
        if not n > least:
            n = 0.0
    if not length(minus(second, scaled(m, cross(first, s)))) <= GATE * bound**3:
        m = np.nan
    return Motion(s, m, nu, n)


def rate_about(turn, u, first, least):
    """Return the rate r for which r * turn is nearest to the vector `first`, or 0 if |r| <= least, or nan if |turn| is nearly 0."""
    if not length(turn) > GATE * length(u):
        return np.nan
    value = dot(first, turn) / dot(turn, turn)
    return 0.0 if abs(value) <= least else value


def rest_of(start, motion):
    """Return the relative angular velocity u of a start and its derivative u', each minus its value in a motion."""
    s, m, nu, n = motion
    u = minus(minus(start.u, scaled(n, nu)), scaled(m, s))
    return u, minus(start.acceleration, scaled(n * m, cross(nu, s)))


def is_beside(start, motion, bound):
    rate, change = rest_of(start, motion)
    return fmax(length(rate) / bound, length(change) / bound**2) <= GATE


def is_steady(start, constants, motion, bound, derived):
    """Return whether the residual vanishes at all nodes of a candidate. If the axes are `derived`, their errors raise the tolerance."""
    s, m, nu, n = motion
    rate, _ = rest_of(start, motion)
    frame = length(start.frame)
    for i in range(3):
        if not abs(rate[i]) <= TERM_ROUNDING * (abs(n) + frame + abs(m * s[i])):
            return False
    p, q = phases(start, motion)
    nodes = 2 * DEGREE * (p + q) + 1
    terms = (0.0, 0.0, 0.0)
    # The last node is tested first, because both phases have changed there and most candidates fail at once.
    for j in range(1, nodes + 1):
        angle = -2 * math.pi * j / nodes
        residual = residual_at(start, constants, motion, np.sign(n) * p * angle, np.sign(m) * q * angle)
        if j == 1:
            if not length(residual) <= GATE * bound**2:
                return False
            terms = rounding(start, constants, motion)
            if derived and p != 0 and m != 0:
                error = length(terms) / length(start.acceleration) * fmax(abs(m / n), abs(n / m))
                if error < MAX_ERROR:
                    terms = scaled(1 + error, terms)
        for i in range(3):
            if not residual[i] <= TERM_ROUNDING * terms[i]:
                return False
    return True


def phases(start, motion):
    """Return integers p and q. The residual is tested where the phases |n| t and |m| t are p and q times one angle."""
    _, m, nu, n = motion
    loose = 0.0
    for i in range(len(start.vectors)):
        loose = max(loose, length(cross(start.vectors[i], nu)))
    p = 1 if n != 0 and loose > TERM_ROUNDING else 0
    if m == 0:
        return p, 0
    if p == 0:
        return 0, 1
    q = 2 * DEGREE + 1
    for i in range(len(PERIODS)):
        a, b = PERIODS[i]
        if abs(abs(n) * b - abs(m) * a) <= RATIO * abs(n) * b:
            p, q = a, b
    return p, q


def residual_at(start, constants, motion, alpha, beta):
    """Return |residual| by component at phases `alpha` of n t and `beta` of m t, or inf if body or vectors do not turn as in `motion`."""
    s, m, nu, n = motion
    back, around = (math.cos(alpha), -math.sin(alpha)), (math.cos(beta), -math.sin(beta))
    fixed = rotate(nu, s, around[0], around[1])
    frame = rotate(rotate(start.frame, nu, back[0], back[1]), s, around[0], around[1])
    w = plus(frame, plus(scaled(n, fixed), scaled(m, s)))
    node = start_at(w, rotate_all(start.vectors, nu, back, s, around), constants)
    rate, change = rest_of(node, Motion(s, m, fixed, n))
    if length(rate) + node.slip > 1e-9 * (length(node.u) + length(node.frame)):
        return np.inf, np.inf, np.inf
    return magnitude(change)


def rounding(start, constants, motion):
    """Return for each component of a residual the sum of the terms' magnitudes and changes under relative errors of 1 in the states."""
    s, nu, frame = magnitude(motion.s), magnitude(motion.nu), magnitude(start.frame)
    m, n = abs(motion.m), abs(motion.n)
    base = n + length(frame)
    size = (base + m * s[0], base + m * s[1], base + m * s[2])
    terms = plus(magnitudes(start.w, start.vectors, constants, size), scaled(n * m, cross_sum(nu, s)))
    return plus(terms, cross_sum(frame, size))


def second_derivative(start, constants):
    """Return u'', the second derivative of the angular velocity relative to the frame."""
    bend = derivatives_change(
        start.w, start.vectors, constants, start.slope, turn_all(start.vectors, start.u)
    )
    turn = plus(cross(cross(start.frame, start.u), start.u), cross(start.frame, start.acceleration))
    return minus(bend, turn)


def departure(start, constants, motion, bound, duration, rate_tolerance, angle_tolerance):
    """Return the first-order change of theta', psi' and phi' during a run from a start near `motion`, in units of the tolerance.

    If the third axis is within the angle tolerance of the vertical, return the change of the tilt and of the rate about the vertical.
    The deviation x of the rates from `motion`, a motion about the third axis and the vertical, obeys x' = A x + f near the start,
    with a constant f. If x oscillates without damping and no faster than `bound`, the rates change by at least |f| / bound.
    """
    s, m, g, n = motion
    inside = np.hypot(g[0], g[1]) < angle_tolerance
    if inside:  # near the vertical, n and m are not unique; n = 0 is chosen, so that the third axis rests in the frame
        m, n = start.u[2], 0.0
    offset, f = rest_of(start, Motion(s, m, g, n))
    time = fmin(1 / bound, duration)
    change = fmax(length(f) * time, length(offset))
    result = change / rate_tolerance
    if inside:
        tilt = fmin(result, change * time / angle_tolerance)
        result = fmax(tilt, abs(dot(f, g)) * time / rate_tolerance)
    lasting = result * np.sqrt(time / duration)
    if lasting <= FAR and result > lasting:
        lasting = fmax(lasting, result * undamped(start, constants, duration))
    return lasting


def undamped(start, constants, duration):
    """Return sqrt(t / duration), where the time t of damping is 1 / |divergence of the equations|, but at most `duration`."""
    still = turn_all(start.vectors, (0.0, 0.0, 0.0))
    divergence = 0.0
    for i in range(3):
        axis = (1.0 if i == 0 else 0.0, 1.0 if i == 1 else 0.0, 1.0 if i == 2 else 0.0)
        divergence += derivatives_change(start.w, start.vectors, constants, axis, still)[i]
    return np.sqrt(1 / fmax(1.0, abs(divergence) * duration))
