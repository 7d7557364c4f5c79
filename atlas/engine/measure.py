"""Running statistics of the Euler rates, taken while a point is integrated: no trajectory is kept.

`sample` is pasted into the kernels. Sums run over equidistant samples with Gregory's weights, which
turn the trapezoidal rule into one of eighth order; they are all positive, so that a mean square can
only grow as a run goes on. Methods of long steps are sampled between their steps as well, on the
polynomial of seventh degree through states and slopes at four steps (`between`). Where the third axis
passes near the vertical psi' may be a spike between two samples; `passage` says what the samples then
miss or add, from the pole of psi' in complex time. `finish` turns the sums into means and spreads.
"""

from types import ModuleType

import numpy as np

# Gregory's rule with differences up to the sixth: weights of the first and last seven samples.
GREGORY = np.array([36799, 176648, 54851, 177984, 89437, 130936, 119585]) / 120960
# The trapezoidal rule and Gregory's, by the distance from the nearer end; what is farther has the last weight.
WEIGHTS = np.array([[0.5, *np.ones(len(GREGORY))], [*GREGORY, 1.0]])
# Least number of intervals for the full rule; a shorter run falls back to the trapezoidal rule.
MIN_INTERVALS = 2 * len(GREGORY) - 1

# Rows of the kernel's output: sums (weighted; those of the axis are not), extremes, what the sums are
# taken from, the last sample, the first angle and how often the vertical was passed.
SUMS = (
    "theta_dot", "theta_dot_squared", "outside", "psi_dot", "psi_dot_squared", "phi_dot", "phi_dot_squared",
    "normal_rate", "normal_rate_squared",
)  # fmt: skip
AXIS = ("axis_1", "axis_2")
EXTREMES = (
    "height_min", "height_max", "upper_sine_squared_min", "lower_sine_squared_min", "sine_squared_max", "drift",
)  # fmt: skip
REFERENCES = ("psi_dot_reference", "phi_dot_reference", "normal_rate_reference")
LAST = ("height", "sine_squared", "turn")
PASSAGES = ("first_theta", "passages")
OUTPUTS = SUMS + AXIS + EXTREMES + REFERENCES + LAST + PASSAGES


def sample(motion, cylinder_squared):
    """Euler rates and tilt of one instant from frame_motion = (u1, u2, u3, g1, g2, g3).

    Returns theta', psi', phi', the rate about the vertical, cos theta (`height`), sin^2 theta, `turn` =
    theta' sin theta = -height', and whether sin theta is at least the cylinder's, 1.0 or 0.0: inside psi'
    and phi' have no meaning and are returned as 0.
    """
    u1, u2, u3, g1, g2, g3 = motion
    s2 = g1 * g1 + g2 * g2
    inverse = 1.0 / (s2 if s2 > 1e-300 else 1e-300)
    outside = 1.0 if s2 >= cylinder_squared else 0.0
    along = u1 * g1 + u2 * g2
    turn = u1 * g2 - u2 * g1
    psi_dot = along * inverse * outside
    phi_dot = (u3 - psi_dot * g3) * outside
    return turn * np.sqrt(inverse), psi_dot, phi_dot, along + u3 * g3, g3, s2, turn, outside


def turning(distance, height_0, s2_0, turn_0, height, s2, turn):
    """cos theta and sin^2 theta where theta turns between two samples, else at the second.

    On the cubics through both samples and their slopes, where the line through the slopes is 0: that
    is off by the square of the distance, so the values at the turn are good to its fourth power.
    """
    x = turn_0 / (turn_0 - turn)
    turns = turn_0 * turn < 0.0
    rise = x * x * (3.0 - 2.0 * x)
    bend = 2.0 * distance * x * (1.0 - x) * (1.0 - x) * turn_0
    top = height_0 + rise * (height - height_0) - bend
    wide = s2_0 + rise * (s2 - s2_0) + bend * (height_0 + height)
    return (top if turns else height), (wide if turns else s2)


def between(most: int) -> np.ndarray:
    """Weights of four states, and of their slopes times the step, that give a state between them.

    Shape (most, 3, most, 8), float64: with 1 to `most` parts to a step, in the first, second or third
    interval of the four states, after 1 to `most` of those parts. Hermite's interpolation: exact for
    polynomials of degree 7.
    """
    nodes = np.arange(4.0)
    parts = np.arange(1, most + 1)
    x = np.arange(3)[:, None] + parts / parts[:, None, None]
    found = np.empty((*x.shape, 8))
    for k in range(4):
        others = np.delete(nodes, k)
        square = np.prod((x[..., None] - others) / (k - others), axis=-1) ** 2
        found[..., k] = (1.0 - 2.0 * np.sum(1.0 / (k - others)) * (x - k)) * square
        found[..., 4 + k] = (x - k) * square
    return found


def closing(case, sine_squared, fall, rise, parts):
    """Does the third axis pass the vertical from one node to the next, so near that psi' may be a spike? 1.0 or 0.0.

    sine_squared: sin^2 theta at the first; fall, rise: half its derivative at both, in units of their distance; there
    are `parts` samples to the interval. sin^2 theta is followed as a parabola, with the complex zeros that psi' has
    for poles; beyond a distance of four samples from the real axis these do no harm (exp(-8 pi)). In the first
    interval of the run, case 0, the passage may be up to two intervals earlier, in the last, case 2, as much later.
    """
    early, late = (2.0 if case == 0 else 0.0), (2.0 if case == 2 else 0.0)
    bend = rise - fall
    least = sine_squared * bend - fall * fall
    wide = 4.0 if case == 1 else 12.0
    near = 1.0 if least * parts * parts < wide * wide * bend * bend else 0.0
    return near if fall < early * bend and rise >= -late * bend else 0.0


def passage(forms, case, first, parts, samples, ends, psi_reference, phi_reference, cylinder_squared):
    """What the weighted samples of theta'^2, psi', psi'^2, phi', phi'^2 sum up to more than their integrals do, on
    a passage of the vertical in the interval after node `case` of four nodes, 0 to 3; 0 where there is none.

    forms: complex128, (3, 8), overwritten: zeta = g1 + i g2, upsilon = u1 + i u2 and g3 + i u3 at the nodes 0 to 3,
    each followed by its derivative. The unit of time is the distance between nodes, `parts` that of samples; node 0
    is the sample `first` of `samples` + 1, with the weights that `weight` takes from `ends`. psi' = Re(upsilon / zeta)
    has a pole at the complex zero z of zeta, with residue R, beside which it is regular with the value a; phi' = u3 -
    g3 psi' likewise, and theta'^2 has a residue that is small with the distance from the vertical. What samples make
    of a pole is known (`lattice`).
    """
    for form in forms:  # into Newton's form of the polynomial of seventh degree, by divided differences
        for k in range(6, 0, -2):
            form[k] -= form[k - 2]
        for level in range(2, 8):
            for k in range(7, level - 1, -1):
                form[k] = (form[k] - form[k - 1]) * (1.0 / (k // 2 - (k - level) // 2))
    middle = case + 0.5
    z = middle + 0.0j
    slope = 0j
    for _ in range(20):
        value, slope, _ = _newton_form(forms[0], z)
        move = value * _inverse(slope)
        z -= move
        if not move.real * move.real + move.imag * move.imag > 1e-18:  # the next one would be its square
            break
    least = z.imag * z.imag * (slope.real * slope.real + slope.imag * slope.imag)
    far = 1.5 if case == 1 else 2.5
    if not (
        abs(z.imag) * parts < (5.0 if case == 1 else 15.0)
        and abs(z.real - middle) < far
        and least > cylinder_squared
    ):
        return 0.0, 0.0, 0.0, 0.0, 0.0
    _, slope, bend = _newton_form(forms[0], z)
    turn, turning, _ = _newton_form(forms[1], z)
    mirror = z.conjugate()
    other_value, _, _ = _newton_form(forms[0], mirror)
    other_turn, _, _ = _newton_form(forms[1], mirror)
    one, one_slope, _ = _newton_form(forms[2], z)
    two, two_slope, _ = _newton_form(forms[2], mirror)
    g3, u3 = 0.5 * (one + two.conjugate()), -0.5j * (one - two.conjugate())
    g3_slope = 0.5 * (one_slope + two_slope.conjugate())
    inverse = _inverse(slope)
    R = 0.5 * turn * inverse
    a = 0.5 * (
        (other_turn * _inverse(other_value)).conjugate() + turning * inverse - turn * bend * inverse * inverse
    )
    R_phi, a_phi = -g3 * R, u3 - g3 * a - g3_slope * R
    R_theta = -0.25 * turn * turn * other_value.conjugate() * inverse
    a, a_phi = a - psi_reference, a_phi - phi_reference
    # The formulas of `lattice` are for a pole above the real axis; the other of the pair is its mirror image.
    above = z.imag > 0.0
    once, twice = lattice(first + parts * (z if above else mirror), samples, ends)
    once, twice = (once if above else once.conjugate()), (twice if above else twice.conjugate())
    once, twice = 2.0 * parts * once, 2.0 * parts * parts * twice
    return (
        (once * R_theta).real, (once * R).real, (twice * R * R + 2.0 * once * R * a).real,
        (once * R_phi).real, (twice * R_phi * R_phi + 2.0 * once * R_phi * a_phi).real,
    )  # fmt: skip


def lattice(z, samples, ends):
    """What the weighted sums of 1 / (k - z) and 1 / (k - z)^2 over k = 0 ... samples exceed their integrals by.

    z: complex, above the real axis. Far from both ends Poisson's sum formula says it: 2 pi i q / (1 - q) with
    q = exp(2 pi i z), and its derivative by z. Near an end the sums themselves, as far as the pole is felt.
    """
    reach = 24
    if min(z.real, samples - z.real) >= reach:
        q = np.exp(2j * np.pi * (z - np.floor(z.real)))
        inverse = _inverse(1.0 - q)
        once = 2j * np.pi * q * inverse
        return once, 2j * np.pi * once * inverse
    intervals = min(samples, 2 * reach)
    if z.real >= reach:
        z = z - (samples - intervals)
    once = np.log(-z) - np.log(intervals - z)
    twice = _inverse(z) + _inverse(intervals - z)
    for k in range(intervals + 1):
        term = _inverse(k - z)
        weighed = weight(k, intervals, ends) * term
        once += weighed
        twice += weighed * term
    return once, twice


def _inverse(z):
    """1 / z without an error where z is 0: nan or inf, as for real numbers."""
    return z.conjugate() * (1.0 / (z.real * z.real + z.imag * z.imag))


def _newton_form(form, z):
    """Value, first derivative and half the second of a polynomial at z, from Newton's form on 0, 0, 1, 1, ... 3."""
    value, slope, bend = form[7], 0j, 0j
    for k in range(6, -1, -1):
        x = z - k // 2
        bend = bend * x + slope
        slope = slope * x + value
        value = value * x + form[k]
    return value, slope, bend


def weight(k, intervals, ends):
    """Weight of the k-th of intervals + 1 samples in units of their distance; ends: WEIGHTS."""
    inside = ends.shape[1] - 1
    near = max(0, min(k, intervals - k, inside))
    return ends[1 if intervals >= 2 * inside - 1 else 0, near]


def tilt(height: np.ndarray, sine_squared: np.ndarray) -> np.ndarray:
    """theta in rad, 0 to pi, from cos theta and sin^2 theta: from each where it tells more."""
    small = np.arcsin(np.sqrt(np.clip(sine_squared, 0.0, 1.0)))
    near = np.where(height > 0, small, np.pi - small)
    return np.where(np.abs(height) > 0.5, near, np.arccos(np.clip(height, -1.0, 1.0)))


def finish(out: np.ndarray, intervals: np.ndarray, parts: np.ndarray | int = 1) -> dict[str, np.ndarray]:
    """Means and spreads from the kernel's output.

    out: (len(OUTPUTS), points) float64; intervals: (points,) samples less one; parts: samples from one look
    to the next, as in steps.Steps. Returns float64 arrays of shape (points,): theta_dot_rms, theta_dot_std,
    psi_dot_mean, psi_dot_std, phi_dot_mean, phi_dot_std (over the samples outside the cylinder, nan if
    there are none), normal_rate_mean, normal_rate_std, theta_min, theta_max, sine_max, integral_drift and
    axis_1, axis_2 (means of the system's axis_in_frame).
    """
    row = dict(zip(OUTPUTS, out, strict=True))
    with np.errstate(all="ignore"):
        # np.maximum hands nan on: a run that was lost stays visible
        square, mean = row["theta_dot_squared"] / intervals, row["theta_dot"] / intervals
        result = {
            "theta_dot_rms": np.sqrt(square),
            "theta_dot_std": np.sqrt(np.maximum(square - mean**2, 0.0)),
        }
        for name, total in (
            ("psi_dot", row["outside"]),
            ("phi_dot", row["outside"]),
            ("normal_rate", intervals),
        ):
            shifted = row[name] / total
            result[f"{name}_mean"] = row[f"{name}_reference"] + shifted
            square = row[f"{name}_squared"] / total
            result[f"{name}_std"] = np.sqrt(np.maximum(square - shifted**2, 0.0))
        last, square = row["height"], row["sine_squared"]  # an end is no turn
        low, high = np.minimum(row["height_min"], last), np.maximum(row["height_max"], last)
        widest = np.maximum(row["sine_squared_max"], square)
        above = np.minimum(row["upper_sine_squared_min"], np.where(last > 0, square, 1.0))
        below = np.minimum(row["lower_sine_squared_min"], np.where(last < 0, square, 1.0))
        # All on one side of the equator the widest tilt is the extreme nearer to it.
        result["theta_min"] = tilt(high, np.where(high > 0, above, widest))
        result["theta_max"] = tilt(low, np.where(low > 0, widest, below))
        result["sine_max"] = np.sqrt(np.minimum(widest, 1.0))
        result["integral_drift"] = row["drift"].copy()
        looks = intervals // parts + 1
        result["axis_1"] = row["axis_1"] / looks
        result["axis_2"] = row["axis_2"] / looks
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
