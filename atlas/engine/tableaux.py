"""Explicit Runge-Kutta methods: Butcher tableaux, their limits, and unrolled source for one step."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction


@dataclass(frozen=True)
class Method:
    """A fixed-step explicit method, with what is known of it on x' = i w x at y = w h.

    order: global order p. The phase error per step is phase * y^(p+1), the loss of amplitude per
    step damping * y^(damping_order); stability: largest stable y. parts: most samples per step, so
    that the statistics keep up with the states. span: the step in the kernel's unit of time, chosen so that
    most coefficients times the step are 1.
    """

    name: str
    order: int
    a: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]
    phase: float
    damping: float
    damping_order: int
    stability: float
    parts: int = 1
    span: float = 1.0

    @property
    def stages(self) -> int:
        return len(self.b)


RK4 = Method(
    "rk4",
    4,
    ((), (0.5,), (0.0, 0.5), (0.0, 0.0, 1.0)),
    (1 / 6, 1 / 3, 1 / 3, 1 / 6),
    phase=float(Fraction(1, 120)),
    damping=float(Fraction(1, 144)),
    damping_order=6,
    stability=8**0.5,
    span=2.0,
)
# The twelve stages of DOP853, its eighth-order solution without the error estimate: Hairer, Norsett and
# Wanner, Solving Ordinary Differential Equations I, 2nd ed. (1993), section II.5.
RK8 = Method(
    "rk8",
    8,
    (
        (),
        (0.05260015195876773,),
        (
            0.0197250569845379,
            0.0591751709536137,
        ),
        (
            0.02958758547680685,
            0.0,
            0.08876275643042054,
        ),
        (
            0.2413651341592667,
            0.0,
            -0.8845494793282861,
            0.924834003261792,
        ),
        (
            0.037037037037037035,
            0.0,
            0.0,
            0.17082860872947386,
            0.12546768756682242,
        ),
        (
            0.037109375,
            0.0,
            0.0,
            0.17025221101954405,
            0.06021653898045596,
            -0.017578125,
        ),
        (
            0.03709200011850479,
            0.0,
            0.0,
            0.17038392571223998,
            0.10726203044637328,
            -0.015319437748624402,
            0.008273789163814023,
        ),
        (
            0.6241109587160757,
            0.0,
            0.0,
            -3.3608926294469414,
            -0.868219346841726,
            27.59209969944671,
            20.154067550477894,
            -43.48988418106996,
        ),
        (
            0.47766253643826434,
            0.0,
            0.0,
            -2.4881146199716677,
            -0.590290826836843,
            21.230051448181193,
            15.279233632882423,
            -33.28821096898486,
            -0.020331201708508627,
        ),
        (
            -0.9371424300859873,
            0.0,
            0.0,
            5.186372428844064,
            1.0914373489967295,
            -8.149787010746927,
            -18.52006565999696,
            22.739487099350505,
            2.4936055526796523,
            -3.0467644718982196,
        ),
        (
            2.273310147516538,
            0.0,
            0.0,
            -10.53449546673725,
            -2.0008720582248625,
            -17.9589318631188,
            27.94888452941996,
            -2.8589982771350235,
            -8.87285693353063,
            12.360567175794303,
            0.6433927460157636,
        ),
    ),
    (
        0.054293734116568765,
        0.0,
        0.0,
        0.0,
        0.0,
        4.450312892752409,
        1.8915178993145003,
        -5.801203960010585,
        0.3111643669578199,
        -0.1521609496625161,
        0.20136540080403034,
        0.04471061572777259,
    ),
    phase=6.402e-8,
    damping=2.277e-8,
    damping_order=10,
    stability=5.960359811702219,
    parts=4,
)
METHODS = {method.name: method for method in (RK4, RK8)}


def step_source(method: Method, states: int) -> str:
    """Source of one step, of length method.span, on the scalars y0, y1, ...: calls rhs(state, constants)."""
    # The first weight is factored out: the inner coefficients of rk4 are then 1, 2, 2, 1, which needs additions only
    # and leaves the multipliers, the narrowest part of the processor, to the equations. The sum s goes along with the
    # stages: fewer of them are in use at once.
    lines, first = [], method.b[0]
    for stage in range(method.stages):
        moves = (_sum(method.a[stage], method.span, i) for i in range(states))
        state = [f"y{i} + ({move})" if move else f"y{i}" for i, move in enumerate(moves)]
        names = ", ".join(f"k{stage}_{i}" for i in range(states))
        lines.append(f"{names} = rhs(({', '.join(state)}), constants)")
        terms = [_sum((0.0,) * stage + (method.b[stage] / first,), 1.0, i) for i in range(states)]
        before = "s{i} + " if stage else ""
        lines += [f"s{i} = {before.format(i=i)}{term}" for i, term in enumerate(terms) if term]
    lines += [f"y{i} = y{i} + {first * method.span!r} * s{i}" for i in range(states)]
    return "\n".join(lines)


def _sum(coefficients: tuple[float, ...], factor: float, i: int) -> str:
    """Component i of the slopes k, weighted by coefficients times factor."""
    forms = {1.0: "{k}", 2.0: "({k} + {k})"}
    terms = [(f"k{j}_{i}", a * factor) for j, a in enumerate(coefficients) if a != 0.0]
    return " + ".join(forms.get(a, f"{a!r} * {{k}}").format(k=k) for k, a in terms)
