"""Jacobi's elliptic functions by the arithmetic-geometric mean, without cancellation near k = 1.

M. Abramowitz and I. A. Stegun, Handbook of Mathematical Functions, 16.4, 16.12, 17.6.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...systems.base import Array


class EllipticFunctions(NamedTuple):
    """Sequences of the arithmetic-geometric mean of 1 and sqrt(1 - k^2), with an array (points,) for each level."""

    a: list[Array]
    b: list[Array]
    c: list[Array]  # k, then c_n = (a_{n-1} - b_{n-1}) / 2 = a_n - b_{n-1}

    @classmethod
    def of(cls, modulus: Array, complement: Array) -> EllipticFunctions:
        """Return the sequences for the elliptic modulus k. `modulus` is k^2, and `complement` is 1 - k^2."""
        a, b, c = [np.ones_like(modulus)], [np.sqrt(complement)], [np.sqrt(modulus)]
        while (unequal := c[-1] > 1e-9 * a[-1]).any():
            # The means of a point stay the same after convergence, so that their bits do not depend on other points.
            b[-1] = np.where(unequal, b[-1], a[-1])
            a.append(0.5 * (a[-1] + b[-1]))
            b.append(np.sqrt(a[-2] * b[-1]))
            c.append(np.where(unequal, c[-1] ** 2 / (4 * a[-1]), 0.0))
        return cls(a, b, c)

    def functions(self, turns: Array) -> tuple[Array, Array, Array]:
        """Return sn, cn and dn at u = 4 K `turns`, with the quarter period K."""
        sn, cn, dn = np.sin(2 * np.pi * turns), np.cos(2 * np.pi * turns), np.ones_like(turns)
        for a, b, c in zip(self.a[:0:-1], self.b[-2::-1], self.c[:0:-1], strict=True):
            ratio = c / a
            below = 1 / (1 + ratio * sn * sn)
            # Here a is b + c. The sum b + c cn^2 equals a - c sn^2 and has no cancellation.
            sn, cn, dn = (1 + ratio) * sn * below, cn * dn * below, (b / a + ratio * cn * cn) * below
        return sn, cn, dn

    def periodic(self, turns: Array) -> tuple[Array, Array]:
        """Return am(u) - 2 pi `turns` and Jacobi's zeta function Z(u) at u = 4 K `turns`, with the quarter period K."""
        level = len(self.a) - 1
        phase = 2 * np.pi * 2.0**level * (turns - np.round(turns))
        amplitude, zeta = np.zeros_like(phase), np.zeros_like(phase)
        for n in range(level, 0, -1):
            sine = np.sin(phase)
            correction = np.arcsin(self.c[n] / self.a[n] * sine)
            amplitude, zeta = amplitude + correction / 2.0**n, zeta + self.c[n] * sine
            phase = 0.5 * (phase + correction)
        return amplitude, zeta

    def squares(self, weight: float) -> Array:
        """Return the sum over n > 0 of (weight - 2^(n-1)) c_n^2."""
        return sum(((weight - 2.0**n) * c**2 for n, c in enumerate(self.c[1:])), np.zeros(1))
