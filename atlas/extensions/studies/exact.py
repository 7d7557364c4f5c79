"""Exact motions of rigid bodies and gyrostats, by elliptic functions.

The motions check the equations and the statistics of the kernel, and use neither. A motion is made for one point and called with
an array of times. The angles are Euler's. The vertical in body axes is gamma = (sin theta sin phi, sin theta cos phi, cos theta),
and the angular velocity relative to the frame is psi' gamma + phi' e3 + theta' (cos phi, -sin phi, 0). Angles are in rad.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

import numpy as np
from scipy.special import ellipkm1, elliprf

from ...systems.base import Array, Points, System
from ..plane.elliptic import EllipticFunctions

FOURIER_SAMPLES = 1024  # number of samples in one period of the precession of a free body


class EulerMotion(NamedTuple):
    """Angle and rates of a motion, as arrays of the shape of the times. On the vertical psi' and phi' are nan."""

    theta: Array  # rad
    theta_dot: Array  # rad per time unit, like all rates
    psi_dot: Array
    phi_dot: Array
    normal_rate: Array  # rate about the vertical, relative to the frame
    cos_theta_dot: Array  # -theta' sin theta, which is smooth even where the axis passes near the vertical


class Motion(Protocol):
    """An exact motion of one body from one start."""

    rate: float  # approximate fastest angular frequency, rad per time unit
    period: float  # period, in time units, of theta and of all rates, or inf

    def __call__(self, time: Array) -> EulerMotion:
        """Return angles and rates at the times."""


# The functions below take 1 - m, the complement of the parameter m. Near a separatrix, 1 - m computed from m loses digits.


def jacobi(argument: Array, complement: float) -> tuple[Array, Array, Array]:
    """Return sn, cn and dn at `argument` for the squared modulus m = 1 - complement. The complement must be above 0."""
    if not 0 < complement <= 1:
        raise ValueError(f"complement = {complement!r}: must be above 0 and at most 1")
    mean = EllipticFunctions.of(np.asarray(1.0 - complement), np.asarray(complement))
    return mean.functions(argument * mean.a[-1] / (2 * np.pi))


def inverse_jacobi(sn: float, cn: float, complement: float) -> float:
    """Return the argument between -2 K and 2 K at which sn and cn have these values. K is the quarter period for m = 1 - complement."""
    quarter = float(ellipkm1(complement))
    first = float(sn * elliprf(cn**2, cn**2 + complement * sn**2, sn**2 + cn**2))
    return first if cn >= 0 else float(np.copysign(2 * quarter, sn)) - first


class SymmetricTop:
    """Heavy symmetric gyrostat about a fixed point in a motion that is not steady. Jacobi's functions give cos theta, psi' and phi'.

    The potential is -weight cos theta. Let u = cos theta, and let r be the angular velocity about the axis of symmetry, l the rotor,
    a = (C r + l) / A, b = (angular momentum about the vertical) / A and beta = 2 weight / A. With a constant e from the energy,

        u'^2 = (1 - u^2) (e + beta u) - (b - a u)^2,  psi' = (b - a u) / (1 - u^2),  phi' = r - psi' u.

    With constants lambda and delta, u = u2 - (u2 - u1) sn^2(lambda t + delta) between roots u1 and u2 of a cubic. No digits of 1 - u or
    1 + u cancel. psi' is relative to a frame that turns at `frame_rate`. E. T. Whittaker, Analytical Dynamics, 4th ed., sections 71-73.
    """

    def __init__(
        self, A: float, C: float, rotor: float, weight: float, start: Sequence[float], frame_rate: float = 0.0
    ):
        """`start` contains the initial theta, theta', psi' and phi'."""
        self.frame_rate = frame_rate
        theta0, theta_dot0, n, m = start
        n = n + frame_rate
        # These are 1 - u and 1 + u at the start. They are exchanged below if the weight is negative.
        low, high = 2 * np.sin(theta0 / 2) ** 2, 2 * np.cos(theta0 / 2) ** 2
        self.spin = m + n * np.cos(theta0)
        self.a = (C * self.spin + rotor) / A
        # `upper` is b - a and `lower` is b + a, with the letters of the class docstring.
        self.upper, self.lower = low * (n * high - self.a), high * (n * low + self.a)
        self.flipped = weight < 0
        a, upper, lower, slope = self.a, self.upper, self.lower, np.sqrt(low * high) * theta_dot0
        if self.flipped:
            low, high, a, upper, lower, slope = high, low, -a, lower, upper, -slope
        beta = 2 * abs(weight) / A
        kinetic = theta_dot0**2 + n**2 * low * high
        self._find_range(beta, kinetic, low, high, a, upper, lower)
        # The slope theta' sin theta gives the phase of the start. The phase is exact if the slope is 0.
        above, below = max(low - self.x, 0.0), max(high - self.y, 0.0)
        sn, cn = np.sqrt(above / self.width), np.sqrt(below / self.width)
        dn = np.sqrt(cn**2 + self.complement * sn**2)
        if above < below:
            sn = slope / (2 * self.width * self.frequency * cn * dn)
        else:
            sn = float(np.copysign(sn, slope))
            cn = slope / (2 * self.width * self.frequency * sn * dn)
        self.phase = inverse_jacobi(sn, cn, self.complement)
        self.rate = abs(self.spin) + abs(self.a) + abs(n) + 2 * self.frequency
        self.period = 2 * float(ellipkm1(self.complement)) / self.frequency

    def _find_range(
        self, beta: float, kinetic: float, low: float, high: float, a: float, upper: float, lower: float
    ) -> None:
        """Find the smallest x = 1 - u and y = 1 + u of the motion, which are roots of cubics, and the modulus and frequency."""
        e_plus, e_minus = kinetic + beta * low, kinetic - beta * high
        # `cubic` has the coefficients of u'^2 as a cubic in x. All roots are real, and Laguerre's steps ascend from 0 to the smallest root.
        cubic = np.array([-(upper**2), 2 * e_plus - 2 * a * upper, -e_plus - 2 * beta - a**2, beta])
        x = 0.0
        for _ in range(100):
            value, slope, curvature = (
                np.polynomial.polynomial.polyval(x, np.polynomial.polynomial.polyder(cubic, k))
                for k in range(3)
            )
            if value >= 0 or slope <= 0:
                break
            x -= 3 * value / (slope + np.sqrt(np.maximum(4 * slope**2 - 6 * value * curvature, 0.0)))
        # With v = 1 + u and the root x, u'^2 = (v - (2 - x)) (r0 + r1 v - beta v^2). The other roots are v = y >= 0 and -third / beta <= 0.
        r0 = lower**2 / (2 - x)
        r1 = (r0 - 2 * e_minus - 2 * a * lower) / (2 - x)
        larger = 0.5 * (abs(r1) + np.sqrt(r1**2 + 4 * beta * r0))
        y, third = (r0 / larger, larger) if r1 < 0 else (larger / beta, beta * r0 / larger)
        self.x, self.y, self.width = x, y, 2 - x - y
        square = beta * (2 - x) + third
        self.frequency = 0.5 * np.sqrt(square)
        self.complement = min((beta * y + third) / square, 1.0)

    def __call__(self, time: Array) -> EulerMotion:
        sn, cn, dn = jacobi(self.frequency * np.asarray(time, float) + self.phase, self.complement)
        x, y = self.x + self.width * sn**2, self.y + self.width * cn**2
        slope = 2 * self.width * self.frequency * sn * cn * dn
        if self.flipped:
            x, y, slope = y, x, -slope
        cosine, square = np.where(x < y, 1 - x, y - 1), x * y
        psi_dot = np.where(x < y, self.upper + self.a * x, self.lower - self.a * y) / square
        return EulerMotion(
            theta=2 * np.arctan2(np.sqrt(x), np.sqrt(y)),
            theta_dot=slope / np.sqrt(square),
            psi_dot=psi_dot - self.frame_rate,
            phi_dot=self.spin - psi_dot * cosine,
            normal_rate=psi_dot * square + self.spin * cosine - self.frame_rate,
            cos_theta_dot=-slope,
        )


class FreeGyrostat:
    """Torque-free gyrostat in a motion that is not steady. A rotor, if any, is along a principal axis.

    Axes are renumbered so that the rotor is along the third axis. The first two moments A and B must differ. Energy and magnitude of the
    angular momentum give A (A - B) w1^2 and B (B - A) w2^2 as quadratics of r = w3, and r'^2 = f(r) as a quartic. With a root s of f
    and Weierstrass' function P, which is computed by Jacobi's functions,

        r = s + f'(s) / 4 / (P(t) - f''(s) / 24).

    The body turns about the fixed angular momentum at a rate that is a periodic function of r alone. The Fourier series of this rate is
    integrated term by term. psi' is relative to a frame that turns at `frame_rate`. V. Volterra, Acta Math. 22 (1899) 201-357;
    E. T. Whittaker and G. N. Watson, A Course of Modern Analysis, 20.6.
    """

    def __init__(self, inertia: Array, rotor: Array, w: Array, gamma: Array, frame_rate: float = 0.0):
        along = np.flatnonzero(rotor)
        if along.size > 1:
            raise ValueError("the rotor must be along a principal axis")
        self.roll = 2 - (along[0] if along.size else 2)
        inertia, rotor, w, gamma = (np.roll(vector, self.roll) for vector in (inertia, rotor, w, gamma))
        self.inertia, self.rotor, self.frame_rate = inertia, rotor[2], frame_rate
        if inertia[0] == inertia[1]:
            raise ValueError("the moments across the rotor's axis are equal: use SymmetricTop")
        momentum = inertia * w + rotor
        self.momentum = float(np.sqrt(momentum @ momentum))
        self.energy = float(inertia @ w**2)
        self._find_roots(float(w[2]))
        self._find_phase(w)
        A, B, _ = inertia
        time = self.turn * np.arange(FOURIER_SAMPLES) / FOURIER_SAMPLES
        p, q, _ = self.velocity(time)
        rate = self.momentum * (A * p**2 + B * q**2) / ((A * p) ** 2 + (B * q) ** 2)
        series = np.fft.rfft(rate) / FOURIER_SAMPLES
        if np.abs(series[-8:]).max() > 1e-13 * np.abs(series[0]):
            raise ValueError("the precession about the angular momentum has too narrow peaks")
        self.mean_precession = series[0].real
        terms = np.flatnonzero(np.abs(series) > 1e-16 * np.abs(series[0]))
        terms = terms[terms > 0]
        self.harmonics = 2 * np.pi * terms / self.turn
        self.series = 2 * series[terms] / (1j * self.harmonics)
        self.rate = float(np.abs(w).max() + self.momentum / inertia.min() + 2 * np.pi / self.turn)
        self.period = np.inf
        axis, node, across = self._directions(np.zeros(1), w[:, None])
        self.components = [float(gamma @ vector[:, 0]) for vector in (axis, node, across)]

    def _find_roots(self, r: float) -> None:
        """Find the root s of the quartic f nearest to r, and Weierstrass' e1, e2 and e3 from the other three roots of f."""
        A, B, C = self.inertia
        l, L2, E2 = self.rotor, self.momentum**2, self.energy
        quadratics = [
            np.array([-C * (C - other), -2 * C * l, L2 - l**2 - other * E2]) for other in (B, A)
        ]  # coefficients of A (A - B) w1^2 and B (B - A) w2^2 as quadratics in r = w3
        roots = [(complex(root), i) for i in (0, 1) for root in np.roots(quadratics[i]).tolist()]
        nearest = min((root for root in roots if root[0].imag == 0), key=lambda root: abs(root[0].real - r))
        roots.remove(nearest)
        self.root, self.zero_of = nearest[0].real, nearest[1]
        quartic = np.polymul(*quadratics) / (-A * B * C**2)
        slope, curvature = (np.polyval(np.polyder(quartic, k), self.root) for k in (1, 2))
        self.a2, self.a3 = float(curvature / 12), float(slope / 4)
        values = [(self.a2 / 2 + self.a3 / (root - self.root), i) for root, i in roots]
        values += [(complex(self.a2 / 2), -1)] * (3 - len(values))  # roots at infinity have this value
        self.both_turn = False  # whether w1 and w2 vanish at different turning points of r
        if all(value.imag == 0 for value, _ in values):
            (e1, far), (e2, _), (e3, _) = sorted(((v.real, i) for v, i in values), reverse=True)
            self.roots_real, self.scale, self.shift = True, e1 - e3, e3 - self.a2 / 2
            self.complement, self.frequency = float((e1 - e2) / (e1 - e3)), float(np.sqrt(e1 - e3))
            self.both_turn = far != self.zero_of
        else:
            e2 = next(value.real for value, _ in values if value.imag == 0)
            pair = next(value for value, _ in values if value.imag != 0)
            self.roots_real, self.scale, self.shift = False, abs(e2 - pair), e2 - self.a2 / 2
            self.complement = float(0.5 + 0.75 * e2 / self.scale)
            self.frequency = float(2 * np.sqrt(self.scale))
        # A period of r = w3 is 2 K / frequency if all roots of the quartic f are real, else 4 K / frequency.
        quarters = 2 if self.roots_real else 4
        self.turn = quarters * float(ellipkm1(self.complement)) / self.frequency

    def _find_phase(self, w: Array) -> None:
        """Find the phase of the start, and the initial sign of `other`, the component w1 or w2 that is not 0 where r is `self.root`."""
        A, B, C = self.inertia
        # The slope gives sn, so that the phase is exact at a turning point of r.
        distance, slope = float(w[2] - self.root), float((A - B) * w[0] * w[1] / C)
        ratio = max(float(distance * self.scale / (self.a3 - distance * self.shift)), 0.0)
        if self.roots_real:
            cn = float(np.sqrt(max(1 - ratio, 0.0)))
            dn = np.sqrt(1 - ratio + self.complement * ratio)
            factor = (self.scale + self.shift * ratio) ** 2 / (2 * cn)
        else:
            cn = (1 - ratio) / (1 + ratio)
            dn = np.sqrt(cn**2 + self.complement * (1 - cn**2))
            factor = (self.shift * (1 - cn) + self.scale * (1 + cn)) ** 2 / 4
        sn = float(slope * factor / (self.a3 * self.scale**1.5 * dn))
        self.phase = inverse_jacobi(sn, cn, self.complement)
        self.other = 1 - self.zero_of
        self.sign = np.copysign(1.0, w[self.other])

    def velocity(self, time: Array) -> Array:
        """Return the angular velocity, (3, times), in body axes that are renumbered so that the rotor is along the third axis."""
        A, B, C = self.inertia
        sn, cn, dn = jacobi(self.frequency * time + self.phase, self.complement)
        if self.roots_real:
            denominator = self.scale + self.shift * sn**2
            distance = self.a3 * sn**2 / denominator
            slope = 2 * self.a3 * self.scale**1.5 * sn * cn * dn / denominator**2
        else:
            denominator = self.shift * (1 - cn) + self.scale * (1 + cn)
            distance = self.a3 * (1 - cn) / denominator
            slope = 4 * self.a3 * self.scale**1.5 * sn * dn / denominator**2
        r = self.root + distance
        rest, squares = self.momentum**2 - (C * r + self.rotor) ** 2, self.energy - C * r**2
        squared = ((rest - B * squares) / (A * (A - B)), (rest - A * squares) / (B * (B - A)))
        first, second = (np.sqrt(np.maximum(squared[i], 0.0)) for i in (self.zero_of, self.other))
        # The larger of |w1| and |w2| is the root of an element of `squared`. The other component follows from w3' = (A - B) w1 w2 / C.
        product = C * slope / (A - B)
        second_sign = self.sign * np.where(cn < 0, -1.0, 1.0) if self.both_turn else self.sign
        first_sign = np.where(product * second_sign < 0, -1.0, 1.0)
        large = second >= first
        safe_first, safe_second = np.where(large, 1.0, first), np.where(large, second, 1.0)
        w = np.empty((3, *np.shape(time)))
        w[self.other] = np.where(large, second_sign * second, product / (first_sign * safe_first))
        w[self.zero_of] = np.where(large, product / (second_sign * safe_second), first_sign * first)
        w[2] = r
        return w

    def _directions(self, time: Array, w: Array) -> tuple[Array, Array, Array]:
        """Return three fixed directions in body axes: the angular momentum, the node at the start, and the normal to both."""
        phases = np.exp(1j * np.multiply.outer(time, self.harmonics))
        angle = self.mean_precession * time + ((phases - 1) @ self.series).real
        axis = self.inertia[:, None] * w
        axis[2] += self.rotor
        axis = axis / self.momentum
        node = np.stack([axis[1], -axis[0], np.zeros_like(time)]) / np.hypot(axis[0], axis[1])
        across = np.cross(axis, node, axis=0)
        cosine, sine = np.cos(angle), np.sin(angle)
        return axis, cosine * node - sine * across, sine * node + cosine * across

    def __call__(self, time: Array) -> EulerMotion:
        time = np.asarray(time, float)
        w = self.velocity(time.ravel())
        fixed = self._directions(time.ravel(), w)
        gamma = sum(
            component * direction for component, direction in zip(self.components, fixed, strict=True)
        )
        w, gamma = (np.roll(v, -self.roll, axis=0).reshape(3, *time.shape) for v in (w, gamma))
        return euler_motion(w, gamma, self.frame_rate)


def euler_motion(w: Array, gamma: Array, frame_rate: float = 0.0) -> EulerMotion:
    """Return angles and rates of a body whose third axis is not along gamma. `w` includes the rate of the frame, but psi' does not."""
    sine = np.hypot(gamma[0], gamma[1])
    cos_theta_dot = w[1] * gamma[0] - w[0] * gamma[1]
    psi_dot = (w[0] * gamma[0] + w[1] * gamma[1]) / sine**2
    return EulerMotion(
        theta=np.arctan2(sine, gamma[2]),
        theta_dot=-cos_theta_dot / sine,
        psi_dot=psi_dot - frame_rate,
        phi_dot=w[2] - psi_dot * gamma[2],
        normal_rate=(w * gamma).sum(0) - frame_rate,
        cos_theta_dot=cos_theta_dot,
    )


def motion_of(system: System, kind: str | Callable[[Points], Motion], points: Points, index: int) -> Motion:
    """Return the exact motion of a point, or raise ValueError. `kind` is "symmetric top", "free gyrostat" or a function."""
    points = system.as_euler_angles({name: values[index : index + 1] for name, values in points.items()})
    if callable(kind):
        return kind(points)
    p = {name: float(values[0]) for name, values in points.items()}
    satellite = system.name == "satellite"
    rotor = np.array([p[f"{'k' if satellite else 'l'}{i}"] for i in (1, 2, 3)])
    inertia = np.array([p["A"], p["B"], p["C"]])
    frame_rate = p["Omega"] if satellite else 0.0
    if p.get("damping"):
        raise ValueError(f"a point of the {system.name} with damping has no exact motion")
    if satellite:
        weight = -p["h3"] * np.array([p["mu1"], p["mu2"], p["mu3"]])
        others = [p["h1"] * p["mu1"], p["h1"] * p["mu2"], p["h1"] * p["mu3"], p["Omega"] * np.ptp(inertia)]
        others += [p["drag1"], p["drag2"], p["drag3"]]
    else:
        weight = p["Mg"] * np.array([p["x0"], p["y0"], p["z0"]])
        others = [p["N"] * np.ptp(inertia)]
    only_weight = not any(others)  # whether no other torque acts
    if kind == "symmetric top" and only_weight and p["A"] == p["B"] and not any([*rotor[:2], *weight[:2]]):
        start = p["theta0"], p["theta_dot0"], p["n"], p["m"]
        return SymmetricTop(p["A"], p["C"], float(rotor[2]), float(weight[2]), start, frame_rate)
    if kind == "free gyrostat" and only_weight and not any(weight):
        state, constants = system.initial_state(points), system.constants(points)
        motion = np.array(system.equations.frame_motion(state, constants))[:, 0]
        return FreeGyrostat(inertia, rotor, motion[:3] + frame_rate * motion[3:], motion[3:], frame_rate)
    raise ValueError(f"a point of the {system.name} has no exact motion of the kind {kind!r}")


# An interval of the quadrature is halved until its sum changes by at most QUADRATURE_RTOL times the scale of the integral over the
# run. No motion needs MAX_INTERVALS intervals.
GAUSS_NODES, GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(16)
QUADRATURE_RTOL, MAX_INTERVALS = 1e-13, 100_000


def statistics(motion: Motion, duration: float, cylinder: float | None = None) -> dict[str, float]:
    """Return exact statistics over [0, duration], which may end within a period. Statistics of psi' and phi' are nan on the vertical."""
    turns = int(duration // motion.period)
    first = motion.period if turns else duration
    time, weight = _quadrature(motion, first)
    # The least and largest theta are at the ends, or between nodes where the slope changes its sign.
    nodes = np.concatenate([[0.0], time, [first]])
    slope = motion(nodes).cos_theta_dot
    changes = np.flatnonzero(slope[:-1] * slope[1:] < 0)
    low, high, sign = nodes[changes], nodes[changes + 1], slope[changes]
    for _ in range(60):
        middle = 0.5 * (low + high)
        is_low = motion(middle).cos_theta_dot * sign > 0
        low, high = np.where(is_low, middle, low), np.where(is_low, high, middle)
    theta = motion(np.concatenate([nodes[[0, -1]], 0.5 * (low + high)])).theta
    if turns:  # All whole periods have equal integrals. The last part of a period is integrated separately.
        rest = _quadrature(motion, duration - turns * motion.period)
        time, weight = np.concatenate([time, rest[0]]), np.concatenate([turns * weight, rest[1]])
    result = moments(motion(time), weight / duration, cylinder)
    return result | {"theta_min": float(theta.min()), "theta_max": float(theta.max())}


def moments(motion: EulerMotion, weight: Array, cylinder: float | None = None) -> dict[str, float]:
    """Return rms of theta', means of other rates, deviations of all, and the fraction of time outside a cylinder. `weight` adds up to 1."""
    result = {"theta_dot_rms": float(np.sqrt(weight @ motion.theta_dot**2))}
    if cylinder is not None:
        result["outside"] = float(weight @ (np.sin(motion.theta) >= cylinder))
    for name in ("theta_dot", "psi_dot", "phi_dot", "normal_rate"):
        rate = getattr(motion, name)
        mean = float(weight @ rate)
        result |= {f"{name}_mean": mean, f"{name}_std": float(np.sqrt(weight @ (rate - mean) ** 2))}
    del result["theta_dot_mean"]
    return result


def _quadrature(motion: Motion, duration: float) -> tuple[Array, Array]:
    """Return nodes in ascending order and weights that integrate the rates and the squares of rates over [0, duration]."""
    edges = np.linspace(0.0, duration, 9 + int(motion.rate * duration))
    while edges.size <= MAX_INTERVALS:
        middle = 0.5 * (edges[:-1] + edges[1:])
        halves = np.sort(np.concatenate([edges, middle]))
        whole, parts = _integrals(motion, edges), _integrals(motion, halves)
        parts = parts[:, ::2] + parts[:, 1::2]
        # The scale of a rate's integral is motion.rate x duration. The scale of a square's integral is the integral plus a small term.
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
    """Return the integrals of the four rates and of their squares between neighbouring edges, (8, intervals)."""
    half = 0.5 * np.diff(edges)
    at_nodes = motion(edges[:-1, None] + half[:, None] * (1 + GAUSS_NODES))
    rates = np.nan_to_num([at_nodes.theta_dot, at_nodes.psi_dot, at_nodes.phi_dot, at_nodes.normal_rate])
    return np.concatenate([rates, rates**2]) @ GAUSS_WEIGHTS * half
