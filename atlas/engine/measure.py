"""Running statistics of the Euler rates, taken while a point is integrated: no trajectory is kept.

`sample` is pasted into the kernels. Sums run over equidistant samples with Gregory's weights, which
turn the trapezoidal rule into one of eighth order; they are all positive, so that a mean square can
only grow as a run goes on. `finish` turns the sums into means and spreads.
"""

from types import ModuleType

import numpy as np

# Gregory's rule with differences up to the sixth: weights of the first and last seven samples.
GREGORY = np.array([36799, 176648, 54851, 177984, 89437, 130936, 119585]) / 120960
# Least number of intervals for the full rule; a shorter run falls back to the trapezoidal rule.
LEAST_INTERVALS = 2 * len(GREGORY) - 1

# Rows of the kernel's output: sums (weighted), then extremes.
SUMS = (
    "theta_dot", "theta_dot_squared", "outside", "psi_dot", "psi_dot_squared", "phi_dot", "phi_dot_squared",
    "normal_rate", "normal_rate_squared", "axis_1", "axis_2",
)  # fmt: skip
EXTREMES = ("tilt_min", "tilt_max", "sine_squared_max", "drift")
REFERENCES = ("psi_dot_reference", "phi_dot_reference", "normal_rate_reference")
OUTPUTS = SUMS + EXTREMES + REFERENCES


def sample(motion, cylinder_squared):
    """Euler rates and tilt of one instant from frame_motion = (u1, u2, u3, g1, g2, g3).

    Returns theta', psi', phi', the rate about the vertical, sin^2 theta, the tilt (tan(theta/2) up to
    pi/2, 2 - cot(theta/2) above: monotone in theta and exact at both poles) and whether sin theta is
    at least the cylinder's, 1.0 or 0.0: inside psi' and phi' have no meaning and are returned as 0.
    """
    u1, u2, u3, g1, g2, g3 = motion
    s2 = g1 * g1 + g2 * g2
    guarded = s2 if s2 > 1e-300 else 1e-300
    inverse = 1.0 / guarded
    root = np.sqrt(inverse)
    outside = 1.0 if s2 >= cylinder_squared else 0.0
    psi_dot = (u1 * g1 + u2 * g2) * inverse * outside
    theta_dot = (u1 * g2 - u2 * g1) * root
    phi_dot = (u3 - psi_dot * g3) * outside
    normal_rate = u1 * g1 + u2 * g2 + u3 * g3
    height = g3 if g3 > 0.0 else -g3
    half = s2 * root / (1.0 + height)
    tilt = half if g3 > 0.0 else 2.0 - half
    return theta_dot, psi_dot, phi_dot, normal_rate, s2, tilt, outside


def weights(intervals: int) -> np.ndarray:
    """Weights of intervals + 1 equidistant samples, in units of their distance; they sum to intervals."""
    w = np.ones(intervals + 1)
    if intervals >= LEAST_INTERVALS:
        w[: len(GREGORY)] = GREGORY
        w[-len(GREGORY) :] = GREGORY[::-1]
    else:
        w[0] = w[-1] = 0.5
    return w


def angle(tilt: np.ndarray) -> np.ndarray:
    """theta in rad, 0 to pi, from the tilt that `sample` returns."""
    return np.where(tilt <= 1.0, 2 * np.arctan(tilt), np.pi - 2 * np.arctan(2.0 - tilt))


def finish(out: np.ndarray, intervals: np.ndarray) -> dict[str, np.ndarray]:
    """Means and spreads from the kernel's output.

    out: (len(OUTPUTS), points) float64; intervals: (points,) samples less one. Returns float64 arrays
    of shape (points,): theta_dot_rms, theta_dot_std, psi_dot_mean, psi_dot_std, phi_dot_mean,
    phi_dot_std (over the samples outside the cylinder, nan if there are none), normal_rate_mean,
    normal_rate_std, theta_min, theta_max, sine_max, integral_drift and axis_1, axis_2 (means of the
    system's axis_in_frame).
    """
    row = dict(zip(OUTPUTS, out, strict=True))
    with np.errstate(all="ignore"):
        result = {"theta_dot_rms": np.sqrt(row["theta_dot_squared"] / intervals)}
        mean = row["theta_dot"] / intervals
        result["theta_dot_std"] = np.sqrt(np.maximum(row["theta_dot_squared"] / intervals - mean**2, 0.0))
        for name, total in (
            ("psi_dot", row["outside"]),
            ("phi_dot", row["outside"]),
            ("normal_rate", intervals),
        ):
            shifted = row[name] / total
            result[f"{name}_mean"] = row[f"{name}_reference"] + shifted
            square = row[f"{name}_squared"] / total
            # np.maximum hands nan on: a run that was lost stays visible
            result[f"{name}_std"] = np.sqrt(np.maximum(square - shifted**2, 0.0))
        result["theta_min"] = angle(row["tilt_min"])
        result["theta_max"] = angle(row["tilt_max"])
        result["sine_max"] = np.sqrt(row["sine_squared_max"])
        result["integral_drift"] = row["drift"].copy()
        result["axis_1"] = row["axis_1"] / intervals
        result["axis_2"] = row["axis_2"] / intervals
    return result


def scales(equations: ModuleType, state: np.ndarray, constants: np.ndarray, floors: dict) -> np.ndarray:
    """Reciprocal of the sum of the magnitudes of each integral's terms at the start, (integrals, points).

    floors: by integral, nan where it is not conserved (scale 0: its change does not count), else the
    least size. A sum of exactly zero counts as 1.
    """
    rows = []
    for name in equations.INTEGRALS:
        terms = getattr(equations, name)(state, constants)
        size = np.maximum(sum(np.abs(term) for term in terms), floors[name])
        size = np.where(size == 0.0, 1.0, size)
        rows.append(np.where(np.isnan(size), 0.0, 1.0 / size))
    return np.ascontiguousarray(rows)
