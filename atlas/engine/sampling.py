"""Samples of the Euler rates and the quadrature rule that averages them over a run.

The functions are plain arithmetic on scalars: the kernel calls them for each lane, compiled or not.
"""

import numpy as np

# Gregory's rule with differences up to the sixth: weights of the first and last seven samples.
GREGORY = np.array([36799, 176648, 54851, 177984, 89437, 130936, 119585]) / 120960
# End weights of the trapezoidal rule and of Gregory's, by the distance from the nearer end of the run; samples that
# are farther from it have the last weight. All are positive, so that a weighted sum of squares can only grow.
END_WEIGHTS = np.array([[0.5, *np.ones(len(GREGORY))], [*GREGORY, 1.0]])
# Smallest number of intervals for Gregory's rule; a shorter run uses the trapezoidal rule.
MIN_INTERVALS = 2 * len(GREGORY) - 1


def sample(motion, cylinder_squared):
    """Euler rates and tilt of one instant.

    Parameters
    ----------
    motion : tuple of six floats
        Angular velocity relative to the frame, u1, u2, u3, and the frame's vertical, g1, g2, g3, in body axes.
    cylinder_squared : float
        Square of the cylinder tolerance: where sin^2 theta is below it, psi' and phi' have no meaning.

    Returns
    -------
    theta_dot, psi_dot, phi_dot, normal_rate : float
        Rates in the units of u; psi' and phi' are 0 inside the cylinder.
    cos_theta, sin2_theta, theta_dot_sin_theta : float
        The last is minus the derivative of cos theta.
    outside : float
        1.0 outside the cylinder, 0.0 inside.
    """
    u1, u2, u3, g1, g2, g3 = motion
    sin2_theta = g1 * g1 + g2 * g2
    inverse = 1.0 / (sin2_theta if sin2_theta > 1e-300 else 1e-300)
    outside = 1.0 if sin2_theta >= cylinder_squared else 0.0
    along = u1 * g1 + u2 * g2
    theta_dot_sin_theta = u1 * g2 - u2 * g1
    psi_dot = along * inverse * outside
    phi_dot = (u3 - psi_dot * g3) * outside
    theta_dot = theta_dot_sin_theta * np.sqrt(inverse)
    return theta_dot, psi_dot, phi_dot, along + u3 * g3, g3, sin2_theta, theta_dot_sin_theta, outside


def turning_point(spacing, cos_0, sin2_0, slope_0, cos_1, sin2_1, slope_1):
    """cos theta and sin^2 theta where theta turns between two samples, else their values at the second.

    `slope` is theta' sin theta. Both are taken on the cubics through the two samples and their slopes, at the zero
    of the line through the slopes: that instant is off by the square of the spacing, the values there by its fourth
    power.
    """
    x = slope_0 / (slope_0 - slope_1)
    turns = slope_0 * slope_1 < 0.0
    rise = x * x * (3.0 - 2.0 * x)
    curvature = 2.0 * spacing * x * (1.0 - x) * (1.0 - x) * slope_0
    cos_theta = cos_0 + rise * (cos_1 - cos_0) - curvature
    sin2_theta = sin2_0 + rise * (sin2_1 - sin2_0) + curvature * (cos_0 + cos_1)
    return (cos_theta if turns else cos_1), (sin2_theta if turns else sin2_1)


def quadrature_weight(k, intervals, end_weights):
    """Weight of sample k of intervals + 1, in units of their spacing; end_weights: END_WEIGHTS."""
    inner = end_weights.shape[1] - 1
    from_end = max(0, min(k, intervals - k, inner))
    return end_weights[1 if intervals >= 2 * inner - 1 else 0, from_end]


def hermite_weights(max_samples: int) -> np.ndarray:
    """Weights of four values, and of their derivatives times the step, that give a value between them.

    Hermite interpolation on the nodes 0, 1, 2, 3: exact for polynomials of degree 7.

    Parameters
    ----------
    max_samples : int
        Largest number of samples per step.

    Returns
    -------
    ndarray of float64, shape (max_samples, 3, max_samples, 8)
        First index: samples per step less one; second: interval between the nodes; third: sample in the interval,
        the last of which is the node at its end; fourth: four weights of values, four of derivatives.
    """
    nodes = np.arange(4.0)
    samples = np.arange(1, max_samples + 1)
    x = np.arange(3)[:, None] + samples / samples[:, None, None]
    weights = np.empty((*x.shape, 8))
    for k in range(4):
        others = np.delete(nodes, k)
        square = np.prod((x[..., None] - others) / (k - others), axis=-1) ** 2
        weights[..., k] = (1.0 - 2.0 * np.sum(1.0 / (k - others)) * (x - k)) * square
        weights[..., 4 + k] = (x - k) * square
    return weights
