"""Explicit Runge-Kutta methods, with Butcher tableaux, errors on oscillations and stability limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import factorial
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Method:
    """An explicit Runge-Kutta method. Errors are for x' = i w x and the step h, with y = w h. An invalid tableau raises ValueError."""

    name: str
    order: int  # global order
    a: tuple[tuple[float, ...], ...]  # rows of the Butcher tableau below the diagonal
    b: tuple[float, ...]  # weights of the stages
    # To leading order a step has the error dispersion * y^(order + 1), which is an error of the phase if the order is even. A step
    # loses the fraction dissipation * y^dissipation_order of the amplitude. Fields that are 0 are computed from the tableau.
    dispersion: float = 0.0
    dissipation: float = 0.0
    dissipation_order: int = 0
    stability: float = 0.0  # largest y = w h at which no amplitude grows
    kernel_step: float = 1.0  # step in the kernel's unit of time, chosen to make most coefficients 1
    # Processor time of a step, including samples, divided by the time of a step of rk4. See bench_methods.py.
    step_cost: float = 0.0

    def __post_init__(self) -> None:
        if [len(row) for row in self.a] != list(range(len(self.b))):
            raise ValueError(f"{self.name}: row i of the tableau must have i coefficients")
        first = sum(self.b)
        second = sum(weight * sum(row) for weight, row in zip(self.b, self.a, strict=True))
        if abs(first - 1.0) > 1e-14 or abs(second - 0.5) > 1e-14:
            raise ValueError(f"{self.name}: sum b = {first} (1) and sum b c = {second} (1/2)")
        derived = {"step_cost": self.stages / 4} | self._on_oscillations()
        for name, value in derived.items():
            if not getattr(self, name):
                object.__setattr__(self, name, value)

    def _on_oscillations(self) -> dict[str, float]:
        """Return errors and stability limit, from the stability function R(z) = 1 + sum b a^(k-1) (1, ..., 1) z^k at z = iy."""
        a = np.array([(*row, *[0.0] * (self.stages - len(row))) for row in self.a])
        column, R = np.ones(self.stages), [1.0]
        for _ in self.b:
            R.append(float(np.dot(self.b, column)))
            column = a @ column
        ratio = np.convolve(R, [(-1) ** k / factorial(k) for k in range(2 * self.stages + 4)])  # R(z) exp(-z)
        leading = [k for k in range(1, 2 * self.stages + 4) if abs(ratio[k]) * factorial(k) > 1e-6]
        if leading[0] != self.order + 1:
            raise ValueError(f"{self.name}: its order on oscillations is {leading[0] - 1}, not {self.order}")
        even = next(k for k in leading if k % 2 == 0)
        dissipation = -ratio[even] * (-1) ** (even // 2)
        if dissipation < 0:
            raise ValueError(
                f"{self.name}: no step is stable, for the amplitude of oscillations grows by any"
            )
        signs = 1j ** np.arange(len(R))
        growth = np.convolve(R * signs, R / signs).real[even::2]  # (|R|^2 - 1) / y^even in powers of y^2
        squares = np.roots(growth[::-1])
        limits = squares.real[(squares.real > 0) & (np.abs(squares.imag) <= 1e-9 * np.abs(squares))]
        return {
            "dispersion": abs(ratio[self.order + 1]), "dissipation": dissipation, "dissipation_order": even,
            "stability": float(np.sqrt(limits.min())),
        }  # fmt: skip

    @property
    def stages(self) -> int:
        return len(self.b)

    def step(self, slope: Callable[[Any], Any], state: Any, step_size: Any) -> Any:
        """Return the state after a step of `step_size` time units. `slope` returns the derivative of a state."""
        slopes: list[Any] = []
        for row in (*self.a, self.b):
            change = sum((a * each for a, each in zip(row, slopes, strict=True) if a), 0.0)
            moved = state + step_size * change
            if len(slopes) < self.stages:
                slopes.append(slope(moved))
        return moved


RK4 = Method(
    "rk4",
    4,
    ((), (0.5,), (0.0, 0.5), (0.0, 0.0, 1.0)),
    (1 / 6, 1 / 3, 1 / 3, 1 / 6),
    dispersion=1 / 120,
    dissipation=1 / 144,
    stability=8**0.5,
    kernel_step=2.0,
)
# The eighth-order solution of DOP853, which has twelve stages, without the error estimate. See Hairer, Norsett and
# Wanner, Solving Ordinary Differential Equations I, 2nd ed. (1993), section II.5.
RK8 = Method(
    "rk8",
    8,
    (
        (),
        (0.05260015195876773,),
        (0.0197250569845379, 0.0591751709536137),
        (0.02958758547680685, 0.0, 0.08876275643042054),
        (0.2413651341592667, 0.0, -0.8845494793282861, 0.924834003261792),
        (0.037037037037037035, 0.0, 0.0, 0.17082860872947386, 0.12546768756682242),
        (0.037109375, 0.0, 0.0, 0.17025221101954405, 0.06021653898045596, -0.017578125),
        (0.03709200011850479, 0.0, 0.0, 0.17038392571223998, 0.10726203044637328, -0.015319437748624402,
         0.008273789163814023),
        (0.6241109587160757, 0.0, 0.0, -3.3608926294469414, -0.868219346841726, 27.59209969944671,
         20.154067550477894, -43.48988418106996),
        (0.47766253643826434, 0.0, 0.0, -2.4881146199716677, -0.590290826836843, 21.230051448181193,
         15.279233632882423, -33.28821096898486, -0.020331201708508627),
        (-0.9371424300859873, 0.0, 0.0, 5.186372428844064, 1.0914373489967295, -8.149787010746927,
         -18.52006565999696, 22.739487099350505, 2.4936055526796523, -3.0467644718982196),
        (2.273310147516538, 0.0, 0.0, -10.53449546673725, -2.0008720582248625, -17.9589318631188,
         27.94888452941996, -2.8589982771350235, -8.87285693353063, 12.360567175794303, 0.6433927460157636),
    ),
    (0.054293734116568765, 0.0, 0.0, 0.0, 0.0, 4.450312892752409, 1.8915178993145003, -5.801203960010585,
     0.3111643669578199, -0.1521609496625161, 0.20136540080403034, 0.04471061572777259),
    dispersion=6.402e-8,
    dissipation=2.277e-8,
    stability=5.960359811702219,
    step_cost=8.0,
)  # fmt: skip
METHODS = {method.name: method for method in (RK4, RK8)}
# All runs with tangent vectors use this method, because rk8 needs less time than rk4 for a given error.
TANGENT_METHOD = RK8
