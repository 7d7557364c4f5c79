"""Polynomials through four nodes, for quadrature errors near the vertical and for turning points between two nodes.

Let zeta = g1 + i g2, so that the angle of proper rotation is phi = pi/2 - arg zeta. If the axis passes near the vertical, zeta
as a function of complex time has a zero z close to the real axis. The rates

    phi' = -Im(zeta' / zeta),    psi' = (u3 - phi') / g3,    theta'^2 = g3'^2 / |zeta|^2

have poles at z. The trapezoidal rule converges slowly there, but by Poisson's summation formula the error of the rule has a
closed form (`trapezoid_error_of_pole`). `pole_terms` computes the zero on the polynomial of degree 7 through four nodes of the
motion. The kernel subtracts the errors from the sums.

`turning_point` computes turning points of theta on the same polynomials. `turns_twice` and `place_of_turn` give a first
approximation on the cubic between two nodes. The unit of time is the distance of two nodes.
"""

from enum import IntEnum

import numpy as np

# A pole at this distance from the real axis causes an error of exp(-8 pi), which is negligible. The unit is the distance of two nodes.
REACH = 4.0
# Number of steps of Newton's method for the position of a pole. A step of Halley's method in `pole_terms` follows.
NEWTON_STEPS = 3


class Passage(IntEnum):
    """Rows of a passage near the vertical. Each of the first six members begins four rows, one for each node."""

    G1, G1_SLOPE, G2, G2_SLOPE, U3, U3_SLOPE = range(0, 24, 4)
    TIME = 24  # real instant near the zeros of zeta, relative to the first of the four nodes
    Z_REAL, Z_IMAG = range(25, 27)  # approximate zero z of zeta, relative to the first of the four nodes
    FARTHER = 27  # 1.0 if the farther zero of zeta may be near as well, else 0.0
    VERTICAL = 28  # the sign of g3
    PSI_DOT_REFERENCE, PHI_DOT_REFERENCE = range(29, 31)  # subtracted from psi' and phi' in the sums


PASSAGE_ROWS = max(Passage) + 1


class Term(IntEnum):
    """Rows of the result of `pole_terms`. THETA, PSI and PHI are coefficients of 1 / (t - z) in the squares of the rates."""

    Z_REAL, Z_IMAG = range(2)  # complex time z of the zero of zeta, relative to the first of the four nodes
    CHANGE = 2  # squared modulus of the last correction of the zero z
    SIN2_THETA = 3  # sin^2 theta at the real part of the complex time z
    THETA_REAL, THETA_IMAG, PSI_REAL, PSI_IMAG, PHI_REAL, PHI_IMAG = range(4, 10)
    # Differences between sums and integrals of the rates, see `sum_errors`.
    THETA_DOT_SQUARED_ERROR, PSI_DOT_ERROR, PSI_DOT_SQUARED_ERROR = range(10, 13)
    PHI_DOT_ERROR, PHI_DOT_SQUARED_ERROR = range(13, 15)


def turns_near_vertical(sin2_theta, slope_0, slope_1):
    """Return whether sin^2 theta has a minimum between two nodes and near a zero of zeta (1.0 or 0.0), and the place of the minimum.

    Slopes are half the derivative of sin^2 theta. The parabola through these data must have a zero within REACH of the real axis.
    """
    rises = 1.0 if slope_1 >= 0.0 else 0.0
    turns = rises if slope_0 < 0.0 else 0.0
    curvature = slope_1 - slope_0
    reach = REACH * curvature
    near = turns if sin2_theta * curvature - slope_0 * slope_0 < reach * reach else 0.0
    return near, -slope_0 / (curvature if turns > 0.0 else 1.0)


def difference(table, row, e):
    """Replace four values and four derivatives, in rows `row` to row + 7, by divided differences."""
    (
        table[row, e], table[row + 1, e], table[row + 2, e], table[row + 3, e],
        table[row + 4, e], table[row + 5, e], table[row + 6, e], table[row + 7, e],
    ) = divided_differences(*differences_of(table, row, e))  # fmt: skip


def differences_of(table, row, e):
    """Return the divided differences in rows `row` to row + 7."""
    return (
        table[row, e], table[row + 1, e], table[row + 2, e], table[row + 3, e],
        table[row + 4, e], table[row + 5, e], table[row + 6, e], table[row + 7, e],
    )  # fmt: skip


def zeta_differences(passages, e):
    """Return the divided differences of zeta = g1 + i g2."""
    a0, a1, a2, a3, a4, a5, a6, a7 = differences_of(passages, Passage.G1, e)
    b0, b1, b2, b3, b4, b5, b6, b7 = differences_of(passages, Passage.G2, e)
    return (
        complex(a0, b0), complex(a1, b1), complex(a2, b2), complex(a3, b3),
        complex(a4, b4), complex(a5, b5), complex(a6, b6), complex(a7, b7),
    )  # fmt: skip


def approximate_zero(passages, e, farther):
    """Write the nearer or the farther zero of the parabola that osculates zeta at TIME, and whether the farther zero is near the nodes."""
    x = passages[Passage.TIME, e]
    value, slope, curvature = polynomial(zeta_differences(passages, e), x)
    root = square_root(slope * slope - 4.0 * (curvature * value))
    along = slope.real * root.real + slope.imag * root.imag
    half = -0.5 * (slope + (1.0 if along >= 0.0 else -1.0) * root)
    far = half * complex_inverse(curvature)
    z = far if farther else value * complex_inverse(half)
    passages[Passage.Z_REAL, e], passages[Passage.Z_IMAG, e] = x + z.real, z.imag
    x, y = abs(x + far.real - 1.5), abs(far.imag)
    passages[Passage.FARTHER, e] = 1.0 if y < REACH - 1.0 and x < REACH + 0.5 * y else 0.0


def improve_zero(passages, e):
    """Take a step of Newton's method to the zero of zeta. `passages` holds divided differences."""
    z = complex(passages[Passage.Z_REAL, e], passages[Passage.Z_IMAG, e])
    value, slope, _ = polynomial(zeta_differences(passages, e), z)
    change = value * complex_inverse(slope)
    z = z - change
    passages[Passage.Z_REAL, e], passages[Passage.Z_IMAG, e] = z.real, z.imag


def pole_terms(passages, e, terms, farther):
    """Write the zero z of zeta in passage e, Laurent coefficients at z, and the errors of sums into row `farther` (0 or 1) of `terms`."""
    zeta = zeta_differences(passages, e)
    z = complex(passages[Passage.Z_REAL, e], passages[Passage.Z_IMAG, e])
    value, slope, curvature = polynomial(zeta, z)
    # Take a step of Halley's method. The coefficients below need the same second derivative.
    change = value * complex_inverse(slope)
    change = value * complex_inverse(slope - curvature * change)
    z, slope = z - change, slope - 2.0 * (curvature * change)
    mirror_value, mirror_slope, _ = polynomial(zeta, z.conjugate())
    # Value and derivative of conj(zeta(conj t)) at z. The product of this function with zeta is |zeta|^2 at real t.
    conjugate, conjugate_slope = mirror_value.conjugate(), mirror_slope.conjugate()
    u3_z, _, _ = polynomial(differences_of(passages, Passage.U3, e), z)
    # Near z, phi' is R / (t - z) + a + ... with R = i/2. At z, g3 is 1 or -1.
    vertical = passages[Passage.VERTICAL, e]
    a = 0.5j * (curvature * complex_inverse(slope) - conjugate_slope * complex_inverse(conjugate))
    product = slope * conjugate
    g3_slope = -0.5 * vertical * product
    a_psi = vertical * (u3_z - a) + 0.5j * g3_slope
    # The square of a rate p / (t - z) + q + ... contains 2 p q / (t - z). For psi', p is -g3 R. q is `a` or `a_psi` less the reference.
    theta = 0.25 * product  # from theta'^2 = g3'^2 / |zeta|^2
    psi = -1j * vertical * (a_psi - passages[Passage.PSI_DOT_REFERENCE, e])
    phi = 1j * (a - passages[Passage.PHI_DOT_REFERENCE, e])
    terms[farther, Term.Z_REAL, e], terms[farther, Term.Z_IMAG, e] = z.real, z.imag
    terms[farther, Term.CHANGE, e] = change.real * change.real + change.imag * change.imag
    beside, _, _ = polynomial(zeta, z.real)
    terms[farther, Term.SIN2_THETA, e] = beside.real * beside.real + beside.imag * beside.imag
    terms[farther, Term.THETA_REAL, e], terms[farther, Term.THETA_IMAG, e] = theta.real, theta.imag
    terms[farther, Term.PSI_REAL, e], terms[farther, Term.PSI_IMAG, e] = psi.real, psi.imag
    terms[farther, Term.PHI_REAL, e], terms[farther, Term.PHI_IMAG, e] = phi.real, phi.imag
    sum_errors(terms, farther, e, z, complex(1.0, 0.0), vertical)


def sum_errors(terms, farther, e, tau, slope, vertical):
    """Write the errors that one zero causes in the trapezoidal sums of theta'^2, psi', psi'^2, phi' and phi'^2."""
    simple, double = trapezoid_error_of_pole(tau, slope)
    theta = (
        simple.real * terms[farther, Term.THETA_REAL, e] - simple.imag * terms[farther, Term.THETA_IMAG, e]
    )
    psi = simple.real * terms[farther, Term.PSI_REAL, e] - simple.imag * terms[farther, Term.PSI_IMAG, e]
    phi = simple.real * terms[farther, Term.PHI_REAL, e] - simple.imag * terms[farther, Term.PHI_IMAG, e]
    square = -0.5 * double.real
    terms[farther, Term.THETA_DOT_SQUARED_ERROR, e] = 2.0 * theta
    terms[farther, Term.PSI_DOT_ERROR, e] = vertical * simple.imag
    terms[farther, Term.PSI_DOT_SQUARED_ERROR, e] = square + 2.0 * psi
    terms[farther, Term.PHI_DOT_ERROR, e] = -simple.imag
    terms[farther, Term.PHI_DOT_SQUARED_ERROR, e] = square + 2.0 * phi


def trapezoid_error_of_pole(tau, slope):
    """Return the trapezoidal sums minus the integrals of 1 / (t - z) and 1 / (t - z)^2. `tau` and `slope` are `sampling.stretched` at z."""
    side, turns = (1.0 if tau.imag > 0.0 else -1.0), tau.real - np.floor(tau.real + 0.5)
    q_less_1 = exponential_less_1(complex(-2.0 * np.pi * min(abs(tau.imag), 8.0), 2.0 * np.pi * turns))
    inverse = complex_inverse(-q_less_1)
    simple = 2j * np.pi * (1.0 + q_less_1) * inverse
    double = 2j * np.pi * simple * inverse * complex(slope.real, side * slope.imag)
    return complex(simple.real, side * simple.imag), complex(double.real, side * double.imag)


def exponential_less_1(z):
    """Return exp(z) - 1 for |z| up to 50. The compiler turns the arithmetic into vector instructions."""
    w = z * (1 / 128)
    value = 1.0 + w * (1 / 9)
    for k in range(8, 1, -1):
        value = 1.0 + w * value * (1.0 / k)
    value = w * value
    for _ in range(7):
        value = value * (value + 2.0)
    return value


def complex_inverse(z):
    """Return 1 / z, or 0 if z is 0, where complex division would raise an error."""
    square = z.real * z.real + z.imag * z.imag
    return z.conjugate() * (1.0 / (square if square > 1e-300 else 1e-300))


def square_root(z):
    size = np.sqrt(z.real * z.real + z.imag * z.imag)
    real, imag = np.sqrt(0.5 * abs(size + z.real)), np.sqrt(0.5 * abs(size - z.real))
    return complex(real, imag if z.imag >= 0.0 else -imag)


def divided_differences(v0, v1, v2, v3, d0, d1, d2, d3):
    """Return the divided differences on 0, 0, 1, 1, 2, 2, 3, 3 of values v and derivatives d at the nodes 0, 1, 2, 3."""
    e0, e1, e2 = v1 - v0, v2 - v1, v3 - v2
    f0, f1, f2, f3, f4, f5 = e0 - d0, d1 - e0, e1 - d1, d2 - e1, e2 - d2, d3 - e2
    h0, h1, h2, h3, h4 = f1 - f0, 0.5 * (f2 - f1), f3 - f2, 0.5 * (f4 - f3), f5 - f4
    i0, i1, i2, i3 = 0.5 * (h1 - h0), 0.5 * (h2 - h1), 0.5 * (h3 - h2), 0.5 * (h4 - h3)
    j0, j1, j2 = 0.5 * (i1 - i0), (i2 - i1) * (1 / 3), 0.5 * (i3 - i2)
    k0, k1 = (j1 - j0) * (1 / 3), (j2 - j1) * (1 / 3)
    return v0, d0, f0, h0, i0, j0, k0, (k1 - k0) * (1 / 3)


def horner(value, slope, curvature, x, coefficient):
    """Take one step of Horner's scheme for value, first derivative and half the second derivative."""
    return value * x + coefficient, slope * x + value, curvature * x + slope


def polynomial(differences, z):
    """Return value, first derivative and half the second derivative at z of a polynomial given by divided differences."""
    c0, c1, c2, c3, c4, c5, c6, c7 = differences
    x1, x2, x3 = z - 1.0, z - 2.0, z - 3.0
    p, s, c = c7 * x3 + c6, c7, c7 * 0.0
    p, s, c = horner(p, s, c, x2, c5)
    p, s, c = horner(p, s, c, x2, c4)
    p, s, c = horner(p, s, c, x1, c3)
    p, s, c = horner(p, s, c, x1, c2)
    p, s, c = horner(p, s, c, z, c1)
    return horner(p, s, c, z, c0)


# Number of steps of Newton's method for the instant of a turning point.
TURN_STEPS = 5


class Turn(IntEnum):
    """Rows of a turning point. Each of the first six members begins four rows, one for each node."""

    G1, G1_SLOPE, G2, G2_SLOPE, G3, G3_SLOPE = range(0, 24, 4)
    TIME = 24  # approximate instant, relative to the first of the four nodes
    NODE = 25  # index, among the four nodes, of the node before the turning point


TURN_ROWS = max(Turn) + 1


def turns_twice(f0, f1, s0, s1, rounding):
    """Return 1.0 if a cubic with slopes of equal sign at 0 and 1 has two extremes in between, else 0.0.

    The values are f0 and f1, the slopes s0 and s1. One of the two extremes may be at 0 or 1. Changes below `rounding` are ignored.
    """
    both = s0 + s1
    excess = both - 3.0 * (f1 - f0)
    may = 1.0 if excess * both > 0.0 else 0.0
    return may if excess * excess > s0 * s1 + rounding * rounding else 0.0


def place_of_turn(f0, f1, s0, s1):
    """Return the place, from 0 to 1, of a cubic's extreme nearest to 0.5. At 0 and 1 the values are f0 and f1, the slopes s0 and s1."""
    a = 3.0 * (s0 + s1 - 2.0 * (f1 - f0))  # the slope of the cubic at x is a x^2 + b x + s0
    b = 2.0 * (3.0 * (f1 - f0) - 2.0 * s0 - s1)
    root = np.sqrt(max(b * b - 4.0 * a * s0, 0.0))
    q = -0.5 * (b + (root if b > 0.0 else -root))
    x = s0 / q if q != 0.0 else 0.5
    y = q / a if a != 0.0 else x
    x = y if min(y, 1.0 - y) > min(x, 1.0 - x) else x
    return min(max(x, 0.0), 1.0)


def newton_change(g1, g2, g3):
    """Return the Newton step to the instant at which theta' sin theta is 0. The arguments are results of `polynomial`."""
    u, du, ddu = g1
    v, dv, ddv = g2
    w, dw, ddw = g3
    radial, sin2_theta = u * du + v * dv, u * u + v * v
    slope = w * (du * du + dv * dv + 2.0 * (u * ddu + v * ddv)) - dw * radial - 2.0 * sin2_theta * ddw
    change = (sin2_theta * dw - w * radial) / slope
    return min(max(change, -0.5), 0.5)


def motion_of_turn(turns, e):
    """Return the results of `polynomial` for g1, g2 and g3 at TIME. `turns` holds divided differences."""
    x = turns[Turn.TIME, e]
    return (
        polynomial(differences_of(turns, Turn.G1, e), x),
        polynomial(differences_of(turns, Turn.G2, e), x),
        polynomial(differences_of(turns, Turn.G3, e), x),
    )


def turning_point(turns, e):
    """Return cos theta and sin^2 theta at TIME in column e of `turns`, and improve TIME by a step of Newton's method.

    TIME stays between NODE and the next node. Newton's method would leave the four nodes if theta varies only by rounding.
    """
    u, v, w = motion_of_turn(turns, e)
    before = turns[Turn.NODE, e] - turns[Turn.TIME, e]
    turns[Turn.TIME, e] += min(max(newton_change(u, v, w), before), before + 1.0)
    return w[0], u[0] * u[0] + v[0] * v[0]
