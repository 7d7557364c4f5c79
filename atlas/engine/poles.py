"""Quadrature errors of psi' where the third axis passes near the vertical.

With zeta = g1 + i g2 and upsilon = u1 + i u2, psi' = Re(upsilon / zeta). Near the vertical zeta has a zero z close to
the real time axis, so that psi' has a pole there, of residue R, beside which it is regular with the value a:

    psi' = 2 Re(R / (t - z)) + a + ...,   phi' = u3 - g3 psi',   theta'^2 has a residue proportional to sin^2 theta.

The trapezoidal rule converges slowly on such a spike, but its error on a pole is a closed form (Poisson summation).
`pole_correction` finds z on the polynomial through four nodes of the motion and returns the error of the weighted sums,
which the kernel subtracts.

The functions are plain arithmetic on scalars and one small work array: they run compiled or not.
"""

import numpy as np

from .sampling import quadrature_weight


def is_near_vertical(interval, sin2_theta, slope_0, slope_1, samples):
    """Whether the third axis passes the vertical between two nodes so near that psi' may be a spike; 1.0 or 0.0.

    Parameters
    ----------
    interval : int
        0: the first interval of the run, whose passage may be up to two intervals earlier; 1: an inner interval;
        2: the last of the run, whose passage may be up to two intervals later.
    sin2_theta : float
        sin^2 theta at the first node.
    slope_0, slope_1 : float
        Half the derivative of sin^2 theta at both nodes, the unit of time being their distance.
    samples : int
        Samples in the interval. sin^2 theta is taken as a parabola, whose complex zeros are poles of psi'; beyond four
        sample spacings from the real axis they do no harm (exp(-8 pi)).
    """
    early, late = (2.0 if interval == 0 else 0.0), (2.0 if interval == 2 else 0.0)
    curvature = slope_1 - slope_0
    min_value = sin2_theta * curvature - slope_0 * slope_0
    width = 4.0 if interval == 1 else 12.0
    near = 1.0 if min_value * samples * samples < width * width * curvature * curvature else 0.0
    return near if slope_0 < early * curvature and slope_1 >= -late * curvature else 0.0


def pole_correction(
    hermite_data,
    interval,
    first,
    samples,
    intervals,
    end_weights,
    psi_reference,
    phi_reference,
    cylinder_squared,
):
    """Excess of the weighted sample sums of five rates over their integrals on one passage of the vertical.

    Parameters
    ----------
    hermite_data : ndarray of complex128, shape (3, 8), overwritten
        zeta = g1 + i g2, upsilon = u1 + i u2 and g3 + i u3 at four nodes, each followed by its derivative; the unit
        of time is the distance between nodes.
    interval : int
        The interval between the nodes in which the passage is, 0, 1 or 2; see `is_near_vertical`.
    first : int
        Number of the sample at the first node.
    samples : int
        Samples per interval.
    intervals : int
        Intervals between the samples of the whole run, whose weights `quadrature_weight` takes from end_weights.
    psi_reference, phi_reference : float
        Values from which psi' and phi' are counted in the sums.
    cylinder_squared : float
        A zero at which |zeta|^2 on the real axis is below this is inside the cylinder and gets no correction.

    Returns
    -------
    tuple of five floats
        Excess of the sums of theta'^2, psi', psi'^2, phi', phi'^2; zeros where there is no passage.
    """
    for values in hermite_data:
        to_newton_form(values)
    middle = interval + 0.5
    z = middle + 0.0j
    slope = 0j
    for _ in range(20):
        value, slope, _ = newton_polynomial(hermite_data[0], z)
        change = value * complex_inverse(slope)
        z -= change
        if not change.real * change.real + change.imag * change.imag > 1e-18:  # the next change is its square
            break
    min_sin2_theta = z.imag * z.imag * (slope.real * slope.real + slope.imag * slope.imag)
    if not (
        abs(z.imag) * samples < (5.0 if interval == 1 else 15.0)
        and abs(z.real - middle) < (1.5 if interval == 1 else 2.5)
        and min_sin2_theta > cylinder_squared
    ):
        return 0.0, 0.0, 0.0, 0.0, 0.0
    mirror = z.conjugate()
    _, slope, curvature = newton_polynomial(hermite_data[0], z)
    upsilon, upsilon_slope, _ = newton_polynomial(hermite_data[1], z)
    zeta_mirror, _, _ = newton_polynomial(hermite_data[0], mirror)
    upsilon_mirror, _, _ = newton_polynomial(hermite_data[1], mirror)
    # g3 and u3 at z: real and imaginary part of the third polynomial, continued to complex time.
    p, p_slope, _ = newton_polynomial(hermite_data[2], z)
    q, q_slope, _ = newton_polynomial(hermite_data[2], mirror)
    g3, u3 = 0.5 * (p + q.conjugate()), -0.5j * (p - q.conjugate())
    g3_slope = 0.5 * (p_slope + q_slope.conjugate())
    inverse = complex_inverse(slope)
    R = 0.5 * upsilon * inverse
    a = 0.5 * (
        (upsilon_mirror * complex_inverse(zeta_mirror)).conjugate()
        + upsilon_slope * inverse
        - upsilon * curvature * inverse * inverse
    )
    R_phi, a_phi = -g3 * R, u3 - g3 * a - g3_slope * R
    R_theta = -0.25 * upsilon * upsilon * zeta_mirror.conjugate() * inverse
    a, a_phi = a - psi_reference, a_phi - phi_reference
    # trapezoid_error_of_pole is for a pole above the real axis; the other pole of the pair is its mirror image.
    above = z.imag > 0.0
    simple, double = trapezoid_error_of_pole(
        first + samples * (z if above else mirror), intervals, end_weights
    )
    simple, double = (simple if above else simple.conjugate()), (double if above else double.conjugate())
    simple, double = 2.0 * samples * simple, 2.0 * samples * samples * double
    return (
        (simple * R_theta).real,
        (simple * R).real,
        (double * R * R + 2.0 * simple * R * a).real,
        (simple * R_phi).real,
        (double * R_phi * R_phi + 2.0 * simple * R_phi * a_phi).real,
    )


def trapezoid_error_of_pole(z, intervals, end_weights):
    """Excess of the weighted sums of 1 / (k - z) and 1 / (k - z)^2, k = 0 ... intervals, over their integrals.

    z is complex, above the real axis. Far from both ends Poisson's summation formula gives 2 pi i q / (1 - q) with
    q = exp(2 pi i z), and its derivative by z; near an end the sums are taken as far as the pole is felt.
    """
    cutoff = 24
    if min(z.real, intervals - z.real) >= cutoff:
        q = np.exp(2j * np.pi * (z - np.floor(z.real)))
        inverse = complex_inverse(1.0 - q)
        simple = 2j * np.pi * q * inverse
        return simple, 2j * np.pi * simple * inverse
    near_end = min(intervals, 2 * cutoff)
    if z.real >= cutoff:
        z = z - (intervals - near_end)
    simple = np.log(-z) - np.log(near_end - z)
    double = complex_inverse(z) + complex_inverse(near_end - z)
    for k in range(near_end + 1):
        term = complex_inverse(k - z)
        weighted = quadrature_weight(k, near_end, end_weights) * term
        simple += weighted
        double += weighted * term
    return simple, double


def complex_inverse(z):
    """1 / z without an error where z is 0: nan or inf, as for real numbers (Numba's complex division raises)."""
    return z.conjugate() * (1.0 / (z.real * z.real + z.imag * z.imag))


def to_newton_form(values):
    """Values and derivatives at 0, 1, 2, 3 become, in place, the divided differences on 0, 0, 1, 1, 2, 2, 3, 3."""
    for k in range(6, 0, -2):
        values[k] -= values[k - 2]
    for level in range(2, 8):
        for k in range(7, level - 1, -1):
            values[k] = (values[k] - values[k - 1]) * (1.0 / (k // 2 - (k - level) // 2))


def newton_polynomial(differences, z):
    """Value, first derivative and half the second derivative at z of the polynomial with these differences."""
    value, slope, curvature = differences[7], 0j, 0j
    for k in range(6, -1, -1):
        x = z - k // 2
        curvature = curvature * x + slope
        slope = slope * x + value
        value = value * x + differences[k]
    return value, slope, curvature
