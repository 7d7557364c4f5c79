"""Text of the kernels: a system's equations, a method's step and the statistics, pasted together.

A kernel advances a block of WIDTH points side by side, one SIMD lane each; every loop over `l` is one that
the compiler turns into vector instructions. Local arrays: Y states, c constants, H step lengths, R reciprocals
of the unit of time, S the rows of measure.OUTPUTS, D and E scales and starting values of the first integrals.

Each point is integrated in units of its own (`scaled` of its equations), in which all steps are method.span long
and most coefficients are 1: a sixth of the multiplications less. The statistics are in the units of the caller.
"""

from __future__ import annotations

import string
from collections.abc import Collection, Mapping
from types import ModuleType

from . import jit, measure
from .simplify import simplify
from .tableaux import METHODS, step_source

WIDTH = 32
# Angular velocity in the frame and its vertical: what the statistics are made from.
MOTION = ("u1", "u2", "u3", "g1", "g2", "g3")
# First integrals are looked at once in so many looks, and at the end: they change slowly.
DRIFT_EVERY = 4


def source(
    equations: ModuleType, method: str, zero: Collection[str] = (), same: Mapping[str, str] = {}
) -> str:
    """Text of the kernel module for a system's equations and a method of runge_kutta.METHODS.

    zero: constants that vanish; same: constants that equal another one (both for every point to come).
    """
    text = {
        name: simplify(body, zero, same, () if name == "scaled" else equations.ONES)
        for name, body in jit.functions(equations).items()
    }
    text |= {name: jit.functions(measure)[name] for name in ("sample", "turning", "weight", "closing")}
    rare = (jit.functions(measure)[name] for name in ("_inverse", "_newton_form", "lattice", "passage"))
    states, constants = range(len(equations.STATE)), range(len(equations.CONSTANTS))
    row = {name: i for i, name in enumerate(measure.OUTPUTS)}
    moving = measure.SUMS + measure.EXTREMES[:-1] + measure.LAST
    parts = METHODS[method].parts
    totals = [_total(equations, name) for name in equations.INTEGRALS]
    axis = "axis_in_frame" in text
    blocks = {
        "FUNCTIONS": "\n\n\n".join(
            [*(f"{jit.INLINE}\n{body}" for body in text.values()), *(f"{jit.FUNCTION}\n{body}" for body in rare)]
        ),
        "KERNEL": jit.KERNEL,
        "LOAD": _lines(f"y{i} = Y[{i}, l]" for i in states),
        "STEP": step_source(METHODS[method], len(states)),
        "STORE": _lines(f"Y[{i}, l] = y{i}" for i in states),
        "STORE_LIVE": _lines(f"Y[{i}, l] = y{i} if live else Y[{i}, l]" for i in states),
        "CONSTANTS": _tuple("constants", (f"c[{i}, l]" for i in constants)),
        "STATE": _tuple("state", (f"Y[{i}, l]" for i in states)),
        "CONSTANTS_IN": _tuple("constants", (f"constants0[{i}, p]" for i in constants)),
        "STATE_IN": _tuple("state", (f"state0[{i}, p]" for i in states)),
        "STATE_SCALED": f"{', '.join(f'Y[{i}, l]' for i in states)} = state",
        "CONSTANTS_SCALED": f"{', '.join(f'c[{i}, l]' for i in constants)} = constants",
        "STATE_OUT": f"{', '.join(f'state0[{i}, p]' for i in states)} = unscaled(state, constants, unit)",
        "SCALES": _lines(
            f"D[{i}, l] = scales[{i}, p]{' * R[l]' * power}" for i, power in enumerate(equations.INTEGRALS.values())
        ),
        "INTEGRALS": _lines(
            f"{total}\nchange = abs(total - E[{i}, l]) * D[{i}, l]\ndrift = change if change > drift else drift"
            for i, total in enumerate(totals)
        ),
        "FIRST_INTEGRALS": _lines(f"{total}\nE[{i}, l] = total" for i, total in enumerate(totals)),
        "ROWS_IN": _lines(f"{name} = S[{row[name]}, l]" for name in moving + measure.REFERENCES),
        "ROWS_OUT": _lines(f"S[{row[name]}, l] = {name}" for name in moving),
        "ROWS_OUT_LIVE": _lines(f"S[{row[name]}, l] = {name} if live else S[{row[name]}, l]" for name in moving),
        "FACTORS": _lines(f"b{k} = between[parts - 1, case, part - 1, {k}]" for k in range(8)),
        "BETWEEN": _lines(f"{name} = {_between(i, METHODS[method].span)}" for i, name in enumerate(MOTION)),
        "STATE_LOADED": _tuple("state", (f"y{i}" for i in states)),
        "MOTION_OUT": f"{_node('slot', 0)} = {', '.join(MOTION)}",
        "SLOPE_OUT": f"{_node('slot', len(MOTION))} = {', '.join(MOTION)}",
        "MOTION_IN": f"{', '.join(MOTION)} = {_node('n', f'{len(MOTION)} * j')}",
    }  # fmt: skip
    numbers = row | {
        "WIDTH": WIDTH, "STATES": len(states), "CONSTS": len(constants), "INTS": len(equations.INTEGRALS),
        "ROWS": len(row), "DRIFT_EVERY": DRIFT_EVERY, "PARTS": parts, "SPAN": METHODS[method].span,
        "NODE_ROWS": 2 * len(MOTION),
    }  # fmt: skip
    for name, part in {  # each may hold those before it
        "MOTION_NOW": MOTION_NOW, "SAMPLE": SAMPLE, "RATES": RATES, "DRIFT": DRIFT,
        "AXIS": AXIS if axis else "pass", "FIRST_AXIS": FIRST_AXIS if axis else "pass",
        "BETWEEN_STEPS": BETWEEN_STEPS if parts > 1 else "",
        "BETWEEN_STEPS_OF_LANES": BETWEEN_STEPS_OF_LANES if parts > 1 else "",
        "NODE": NODE, "CLOSING": CLOSING, "PASSAGE": PASSAGE, "LAST_THETA": LAST_THETA,
        "TAKE": TAKE, "INTERVALS": INTERVALS, "INTERVALS_OF_LANES": INTERVALS_OF_LANES,
    }.items():  # fmt: skip
        blocks[name] = fill(part, blocks, numbers)
    header = f"{jit.HEADER}from {jit.__name__} import aligned_stack\n\nPARTS = {parts}\n"
    return f"{header}{fill(KERNEL + LABEL_KERNEL, blocks, numbers)}"


def _lines(parts) -> str:
    return "\n".join(parts)


def _tuple(name: str, parts) -> str:
    return f"{name} = ({', '.join(parts)},)"


def _total(equations: ModuleType, name: str) -> str:
    """The sum of a first integral's terms."""
    ones = (1.0,) * len(equations.STATE), (1.0,) * len(equations.CONSTANTS)
    terms = [f"t{j}" for j in range(len(getattr(equations, name)(*ones)))]
    return f"{', '.join(terms)}, = {name}(state, constants)\ntotal = {' + '.join(terms)}"


def _node(slot: str, first: int | str) -> str:
    """The rows of a node that hold the motion, or its slope, from the first of them on."""
    return ", ".join(f"P[{slot}, {first} + {i}, l]" for i in range(len(MOTION)))


def _between(i: int, span: float) -> str:
    """Component i of the motion between four nodes, as measure.between weighs them."""
    values = " + ".join(f"b{k} * P[n{k}, {i}, l]" for k in range(4))
    slopes = " + ".join(f"b{k + 4} * P[n{k}, {len(MOTION) + i}, l]" for k in range(4))
    return f"{values} + {span} * ({slopes})"


def fill(template: str, blocks: dict[str, str], numbers: dict[str, float]) -> str:
    """The template with $NAME alone on a line replaced by a block at its indent, elsewhere by a number."""
    lines = []
    for line in template.splitlines():
        name = line.strip().removeprefix("$")
        if line.strip().startswith("$") and name in blocks:
            indent = line[: len(line) - len(line.lstrip())]
            lines += [indent + part if part else "" for part in blocks[name].splitlines()]
        else:
            lines.append(string.Template(line).substitute(numbers))
    return "\n".join(lines) + "\n"


# A point enters its lane with its first sample; there psi', phi' and the rate about the vertical become the
# values from which they are counted.
TAKE = """
H[l] = length[p]
unit = H[l] / $SPAN
R[l] = 1.0 / unit
$STATE_IN
$CONSTANTS_IN
state, constants = scaled(state, constants, unit)
$STATE_SCALED
$CONSTANTS_SCALED
$SCALES
for j in range($ROWS):
    S[j, l] = 0.0
$MOTION_NOW
$SAMPLE
weighs = weight(0, samples, ends)
S[$theta_dot, l] = weighs * theta_rate
S[$first_theta, l] = np.arctan2(np.sqrt(s2), g3)
S[$theta_dot_squared, l] = weighs * theta_rate * theta_rate
S[$outside, l] = weighs * seen
S[$psi_dot_reference, l], S[$phi_dot_reference, l], S[$normal_rate_reference, l] = psi_rate, phi_rate, rate
S[$height, l], S[$sine_squared, l], S[$turn, l] = g3, s2, m
S[$height_min, l], S[$height_max, l], S[$sine_squared_max, l] = g3, g3, s2
S[$upper_sine_squared_min, l] = s2 if g3 > 0.0 else 1.0
S[$lower_sine_squared_min, l] = s2 if g3 < 0.0 else 1.0
$FIRST_AXIS
$FIRST_INTEGRALS
"""
MOTION_NOW = """
u1, u2, u3, g1, g2, g3 = frame_motion(state, constants)
u1, u2, u3 = u1 * R[l], u2 * R[l], u3 * R[l]
"""
SAMPLE = """
theta_rate, psi_rate, phi_rate, rate, g3, s2, m, seen = sample((u1, u2, u3, g1, g2, g3), cylinder)
"""
RATES = """
$SAMPLE
top, wide = turning(distance, height, sine_squared, turn, g3, s2, m)
height, sine_squared, turn = g3, s2, m
psi_rate = (psi_rate - psi_dot_reference) * seen
phi_rate = (phi_rate - phi_dot_reference) * seen
rate = rate - normal_rate_reference
theta_dot += weighs * theta_rate
theta_dot_squared += weighs * theta_rate * theta_rate
outside += weighs * seen
psi_dot += weighs * psi_rate
psi_dot_squared += weighs * psi_rate * psi_rate
phi_dot += weighs * phi_rate
phi_dot_squared += weighs * phi_rate * phi_rate
normal_rate += weighs * rate
normal_rate_squared += weighs * rate * rate
height_min = top if top < height_min else height_min
height_max = top if top > height_max else height_max
upper = wide if top > 0.0 else 1.0
lower = wide if top < 0.0 else 1.0
upper_sine_squared_min = upper if upper < upper_sine_squared_min else upper_sine_squared_min
lower_sine_squared_min = lower if lower < lower_sine_squared_min else lower_sine_squared_min
sine_squared_max = wide if wide > sine_squared_max else sine_squared_max
"""
AXIS = """
$CONSTANTS
$STATE
x, y = axis_in_frame(state, constants)
S[$axis_1, l] += looked * x
S[$axis_2, l] += looked * y
"""
FIRST_AXIS = "S[$axis_1, l], S[$axis_2, l] = axis_in_frame(state, constants)"
DRIFT = """
$CONSTANTS
$STATE
drift = S[$drift, l]
$INTEGRALS
S[$drift, l] = drift
"""
# Node i of the motion, before its steps to the next, lies in slot i % 4 of P: MOTION, then its slope, which
# frame_motion gives as well because it is linear in the state.
NODE = """
for l in range($WIDTH):
    $CONSTANTS
    $LOAD
    $STATE_LOADED
    $MOTION_NOW
    $MOTION_OUT
    state = rhs(state, constants)
    $MOTION_NOW
    $SLOPE_OUT
"""
CLOSING = """
m1, m2 = (slot + 1 + case) & 3, (slot + 2 + case) & 3
for l in range($WIDTH):
    fall = span * (P[m1, 3, l] * P[m1, 9, l] + P[m1, 4, l] * P[m1, 10, l])
    rise = span * (P[m2, 3, l] * P[m2, 9, l] + P[m2, 4, l] * P[m2, 10, l])
    s2 = P[m1, 3, l] * P[m1, 3, l] + P[m1, 4, l] * P[m1, 4, l]
    near[l] = closing(case, s2, fall, rise, parts)
"""
# With nodes i - 3 to i there, the interval from i - 2 to i - 1 can be looked into, and beside it the first and the
# last interval of the run, where there is no node on the far side: samples in the order of time, then spikes of psi'.
INTERVALS = """
n0, n1, n2, n3 = (slot + 1) & 3, (slot + 2) & 3, (slot + 3) & 3, slot
for case in range(3):
    if i >= 3 and (case == 1 or (case == 0 and i == 3) or (case == 2 and i == last_node)):
        $BETWEEN_STEPS
        $CLOSING
        for l in range($WIDTH):
            if near[l] > 0.0:
                $PASSAGE
"""
BETWEEN_STEPS = """
if parts > 1:
    for part in range(1, parts + 1):
        weighs = weight(parts * (i - 3 + case) + part, samples, ends)
        $FACTORS
        for l in range($WIDTH):
            distance = H[l] * share
            $BETWEEN
            $ROWS_IN
            $RATES
            $ROWS_OUT
"""
# The same where every lane is at another node: `at` has gone on by one since node i was laid down.
INTERVALS_OF_LANES = """
n0, n1, n2, n3 = (slot + 1) & 3, (slot + 2) & 3, (slot + 3) & 3, slot
for case in range(3):
    wanted = False
    for l in range($WIDTH):
        i, last_node = at[l] - 1, looks_of[l] - 1 + late
        here = i >= 3 and (case == 1 or (case == 0 and i == 3) or (case == 2 and i == last_node))
        over[l] = 1.0 if here else 0.0
        wanted = wanted or here
    if wanted:
        $BETWEEN_STEPS_OF_LANES
        $CLOSING
        for l in range($WIDTH):
            if near[l] > 0.0 and over[l] > 0.0:
                i, samples = at[l] - 1, parts * looks_of[l]
                $PASSAGE
"""
BETWEEN_STEPS_OF_LANES = """
if parts > 1:
    for part in range(1, parts + 1):
        $FACTORS
        for l in range($WIDTH):
            G[l] = weight(parts * (at[l] - 4 + case) + part, parts * looks_of[l], ends)
        for l in range($WIDTH):
            distance = H[l] * share
            weighs = G[l]
            live = over[l] > 0.0
            $BETWEEN
            $ROWS_IN
            $RATES
            $ROWS_OUT_LIVE
"""

PASSAGE = """
d = H[l] * stride
for k in range(4):
    n = (slot + 1 + k) & 3
    for j in range(2):
        $MOTION_IN
        unit = span if j else 1.0
        forms[0, 2 * k + j] = complex(g1 * unit, g2 * unit)
        forms[1, 2 * k + j] = complex(u1 * d * unit, u2 * d * unit)
        forms[2, 2 * k + j] = complex(g3 * unit, u3 * d * unit)
psi_0, phi_0 = S[$psi_dot_reference, l] * d, S[$phi_dot_reference, l] * d
theta_square, psi_rate, psi_square, phi_rate, phi_square = passage(
    forms, case, parts * (i - 3), parts, samples, ends, psi_0, phi_0, cylinder
)
S[$passages, l] += 1.0
S[$theta_dot_squared, l] -= theta_square / (d * d)
S[$psi_dot, l] -= psi_rate / d
S[$psi_dot_squared, l] -= psi_square / (d * d)
S[$phi_dot, l] -= phi_rate / d
S[$phi_dot_squared, l] -= phi_square / (d * d)
"""

# Where the axis passed the vertical, theta' leapt from one sample to the next: its sum is taken from theta itself.
LAST_THETA = """
if S[$passages, l] > 0.0:
    theta = np.arctan2(np.sqrt(S[$sine_squared, l]), S[$height, l])
    S[$theta_dot, l] = (theta - S[$first_theta, l]) * parts / (H[l] * stride)
"""

KERNEL = """

$FUNCTIONS


$KERNEL
def integrate(
    first, last, points, steps, strides, pieces, length, state0, constants0, scales, ends, between, cylinder, out
):
    aligned_stack()
    Y = np.empty(($STATES, $WIDTH))
    c = np.empty(($CONSTS, $WIDTH))
    H = np.empty($WIDTH)
    R = np.empty($WIDTH)
    D = np.empty(($INTS, $WIDTH))
    E = np.empty(($INTS, $WIDTH))
    S = np.empty(($ROWS, $WIDTH))
    P = np.empty((4, $NODE_ROWS, $WIDTH))
    near = np.empty($WIDTH)
    forms = np.empty((3, 8), np.complex128)
    looked = 1.0
    for block in range(first, last):
        stride, parts = strides[block], pieces[block]
        looks = steps[block] // stride
        samples, share, span = looks * parts, 1.0 / parts, $SPAN * stride
        last_node = looks if parts > 1 else looks - 1
        for l in range($WIDTH):
            p = points[block, l]
            $TAKE
        for i in range(looks + (1 if parts > 1 else 0)):
            slot = i & 3
            $NODE
            for s in range(stride if i < looks else 0):
                for l in range($WIDTH):
                    $CONSTANTS
                    $LOAD
                    $STEP
                    $STORE
            if parts == 1:
                weighs = weight(i + 1, samples, ends)
                for l in range($WIDTH):
                    distance = H[l] * stride
                    $CONSTANTS
                    $STATE
                    $MOTION_NOW
                    $ROWS_IN
                    $RATES
                    $ROWS_OUT
            $INTERVALS
            if i < looks:
                for l in range($WIDTH):
                    $AXIS
            if (i + 1) % $DRIFT_EVERY == 0 or i + 1 == looks:
                for l in range($WIDTH):
                    $DRIFT
        for l in range($WIDTH):
            p = points[block, l]
            unit = H[l] / $SPAN
            $CONSTANTS
            $STATE
            $STATE_OUT
            $LAST_THETA
            for j in range($ROWS):
                out[j, p] = S[j, l]
"""

# For scenes that ask for labels only: a lane is freed as soon as its point is certain to drift and takes
# the next one. All weights are positive, so the sum of theta'^2 only grows: once it passes the tolerance of the
# whole run outside the cylinder, no later motion can bring the label back. A passage of the vertical takes away
# at most one sample beside it, and is over two samples later. (The sums of psi' and phi' do not tell as early:
# what their spikes add too much is taken away when the passage is over.)
# Where there are samples between the steps a point makes one more step, which is not kept, for the slope at its end.
LABEL_KERNEL = """


$KERNEL
def integrate_labels(
    first_point, last_point, queue, stride, parts, looks, length, state0, constants0, scales, ends, between,
    cylinder, tolerance, out, done,
):
    aligned_stack()
    Y = np.zeros(($STATES, $WIDTH))
    c = np.zeros(($CONSTS, $WIDTH))
    H = np.zeros($WIDTH)
    R = np.zeros($WIDTH)
    D = np.zeros(($INTS, $WIDTH))
    E = np.zeros(($INTS, $WIDTH))
    S = np.zeros(($ROWS, $WIDTH))
    P = np.zeros((4, $NODE_ROWS, $WIDTH))
    G = np.zeros($WIDTH)
    limit = np.zeros($WIDTH)
    over = np.zeros($WIDTH)
    moves = np.zeros($WIDTH)
    near = np.zeros($WIDTH)
    forms = np.empty((3, 8), np.complex128)
    span = $SPAN * stride
    at = np.zeros($WIDTH, np.int64)
    never = 1 << 60
    looks_of = np.full($WIDTH, never)
    point_of = np.full($WIDTH, -1)
    following = first_point
    active = 0
    slot = 0
    free = True
    late = 1 if parts > 1 else 0
    share = 1.0 / parts
    least_wide = cylinder * (1.0 + 1e-9)
    while True:
        if free:
            free = False
            for l in range($WIDTH):
                if point_of[l] < 0 and following < last_point:
                    p = queue[following]
                    following += 1
                    active += 1
                    point_of[l] = p
                    at[l] = 0
                    looks_of[l] = looks[p]
                    samples = looks[p] * parts
                    limit[l] = tolerance[p] * tolerance[p] * samples * (1.0 + 1e-6)
                    moves[l] = 1.0
                    $TAKE
            if active == 0:
                break
        slot = (slot + 1) & 3
        $NODE
        for s in range(stride):
            for l in range($WIDTH):
                live = moves[l] > 0.0
                $CONSTANTS
                $LOAD
                $STEP
                $STORE_LIVE
        for l in range($WIDTH):
            at[l] += 1
        if parts == 1:
            for l in range($WIDTH):
                G[l] = weight(at[l], looks_of[l], ends)
            for l in range($WIDTH):
                distance = H[l] * stride
                weighs = G[l]
                $CONSTANTS
                $STATE
                $MOTION_NOW
                $ROWS_IN
                $RATES
                $ROWS_OUT
        $INTERVALS_OF_LANES
        for l in range($WIDTH):
            looked = 1.0 if at[l] <= looks_of[l] else 0.0
            $AXIS
        for l in range($WIDTH):
            $DRIFT
        any_over = 0.0
        for l in range($WIDTH):
            certain = 1.0 if S[$theta_dot_squared, l] > limit[l] else 0.0
            certain = certain if S[$sine_squared_max, l] > least_wide else 0.0
            ended = 1.0 if at[l] - late >= looks_of[l] else certain
            over[l] = ended
            any_over += ended
        if any_over > 0.0:
            for l in range($WIDTH):
                if over[l] > 0.0 and point_of[l] >= 0:
                    p = point_of[l]
                    unit = H[l] / $SPAN
                    $CONSTANTS
                    $STATE
                    $STATE_OUT
                    $LAST_THETA
                    for j in range($STATES):
                        Y[j, l] = 0.0
                    for j in range($ROWS):
                        out[j, p] = S[j, l]
                        S[j, l] = 0.0
                    done[p] = max(at[l] - late, 1)
                    point_of[l] = -1
                    at[l] = 0
                    looks_of[l] = never
                    active -= 1
                    free = True
        for l in range($WIDTH):
            moves[l] = 1.0 if point_of[l] >= 0 and at[l] < looks_of[l] else 0.0
"""
