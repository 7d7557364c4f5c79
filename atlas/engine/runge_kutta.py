"""Explicit Runge-Kutta methods: Butcher tableaux, their limits, and unrolled source for one step."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction


@dataclass(frozen=True)
class Method:
    """A fixed-step explicit method, with what is known of it on x' = i w x at y = w h.

    order: global order p. The phase error per step is phase * y^(p+1), the loss of amplitude per
    step damping * y^(damping_order); stability: largest stable y.
    """

    name: str
    order: int
    a: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]
    phase: float
    damping: float
    damping_order: int
    stability: float

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
)
METHODS = {"rk4": RK4}


def step_source(method: Method, states: int) -> str:
    """Source of one step on the scalars y0, y1, ...: calls rhs(state, constants), step length h."""
    lines = []
    for stage in range(method.stages):
        terms = [(j, a) for j, a in enumerate(method.a[stage]) if a != 0.0]
        if not terms:
            state = [f"y{i}" for i in range(states)]
        elif len(terms) == 1:
            j, a = terms[0]
            scale = "h" if a == 1.0 else f"h{stage}"
            if a != 1.0:
                lines.append(f"{scale} = {a!r} * h")
            state = [f"y{i} + {scale} * k{j}_{i}" for i in range(states)]
        else:
            sums = (" + ".join(f"{a!r} * k{j}_{i}" for j, a in terms) for i in range(states))
            state = [f"y{i} + h * ({total})" for i, total in enumerate(sums)]
        names = ", ".join(f"k{stage}_{i}" for i in range(states))
        lines.append(f"{names} = rhs(({', '.join(state)}), constants)")
    # Factor out the first weight: the inner coefficients of rk4 are then 1, 2, 2, 1.
    weights = [(j, b / method.b[0]) for j, b in enumerate(method.b) if b != 0.0]
    lines.append(f"hb = {method.b[0]!r} * h")
    for i in range(states):
        total = " + ".join(f"k{j}_{i}" if b == 1.0 else f"{b!r} * k{j}_{i}" for j, b in weights)
        lines.append(f"y{i} = y{i} + hb * ({total})")
    return "\n".join(lines)
