"""Plan of an integration and of its measurements, made once from a system, settings and the wanted variables."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..kernel import specialization
from ..kernel.specialization import GENERIC, Specialization
from ..kernel.statistics import STATISTICS
from ..kernel.stepsize import StepSizes
from ..kernel.tableaux import METHODS, TANGENT_METHOD
from ..measure.chaos import Chaos
from ..measure.instrument import Instrument, MainInstrument
from ..scene.grid import Grid
from ..scene.model import MAX_STEPS, Scene, Settings, zero_and_equal
from ..systems.base import Array, System, derived_variables
from ..theory.compiled import FEW_POINTS
from ..variables import default_variables, instruments, main_instrument


@dataclass(frozen=True)
class Plan:
    """The instruments and kernels of a set of points, such as all points of a scene."""

    system: System
    settings: Settings
    outputs: Collection[str] | None = None  # wanted variables, or None for `variables.default_variables`
    specialization: Specialization = GENERIC  # terms that the kernels leave out
    nudged: bool = False  # whether points were moved off the motions of a family
    # Whether theory, like the kernels, runs as machine code. Plain Python is faster for a few points.
    in_machine_code: bool = False

    @classmethod
    def of(cls, scene: Scene) -> Plan:
        terms = Specialization.of(scene.system, *scene.zero_and_equal_parameters())
        many = scene.size > FEW_POINTS
        return cls(scene.system, scene.settings, scene.outputs, terms, bool(scene.nudge), many)

    @classmethod
    def of_points(
        cls,
        system: System,
        settings: Settings,
        outputs: Collection[str] | None,
        given: Collection[str],
        size: int = 1,
    ) -> Plan:
        """Return the plan of `size` points. Parameters named in `given` may have any value. Other parameters have their defaults."""
        defaults = {name: p.default for name, p in system.parameters.items() if name not in given}
        terms = Specialization.of(system, *zero_and_equal(defaults))
        return cls(system, settings, outputs, terms, in_machine_code=size > FEW_POINTS)

    def without_derived(self) -> Plan:
        """Return the plan without derived variables, which need no run but may take long to compute."""
        if self.outputs is None:
            return self
        derived = derived_variables(self.system)
        return replace(self, outputs=[name for name in self.outputs if name not in derived])

    def without_prove(self) -> Plan:
        """Return the plan that integrates every point."""
        return replace(self, settings=replace(self.settings, prove=False))

    @property
    def names(self) -> Collection[str]:
        """Names of the wanted variables. () stands for the default variables, of which none is optional."""
        return self.outputs or ()

    @cached_property
    def main(self) -> MainInstrument:
        """The instrument whose kernel integrates the points."""
        return main_instrument(self.system)

    @cached_property
    def instruments(self) -> tuple[Instrument, ...]:
        """The main instrument, followed by the other instruments that the variables need."""
        others = (each for each in instruments() if each.wanted(self.system, self.names))
        return self.main, *(each for each in others if each != self.main)

    @property
    def plugs(self) -> tuple[Instrument, ...]:
        return tuple(each for each in self.instruments if each.sums)

    def proofs(self, tile: Grid) -> dict[str, NDArray[Any]]:
        """Return the variables that instruments give without a run. See `Instrument.proofs`."""
        tolerances = self.settings.at(tile.rate_tolerance).tolerances
        each = (
            i.proofs(self.system, tile.points, tolerances, self.in_machine_code) for i in self.instruments
        )
        return {name: values for proofs in each for name, values in proofs.items()}

    @property
    def has_chaos(self) -> bool:
        """Whether the points are integrated with tangent vectors as well."""
        return Chaos() in self.instruments

    @property
    def has_tangent(self) -> bool:
        """Whether some points may be integrated with tangent vectors."""
        return self.has_chaos or self.needs_growth

    @property
    def needs_growth(self) -> bool:
        """Whether an instrument may need the growth of errors along a run."""
        return any(each.needs_growth for each in self.instruments)

    @property
    def may_stop_early(self) -> bool:
        whole = self.plugs or any(each.needs_whole_run for each in self.instruments)
        return self.outputs is not None and not whole and self.main.may_stop_early(self.outputs)

    @cached_property
    def without_statistics(self) -> Plan | None:
        """The plan without statistics of the rates, or None if leaving out the statistics does not let runs stop early."""
        statistics = {statistic.name for statistic in STATISTICS}
        names = default_variables(self.system) if self.outputs is None else self.outputs
        plan = replace(self, outputs=[name for name in names if name not in statistics])
        return plan if plan.may_stop_early and not self.may_stop_early else None

    def relative_costs(self, bound: Array, points: Grid) -> dict[str, float]:
        """Return the processor time of each other method divided by that of the plan's method, or {} if a step is given."""
        if self.settings.step is not None:
            return {}
        costs = dict[str, float]()
        for name, method in METHODS.items():
            with np.errstate(all="ignore"):
                settings = replace(self.settings, method=name, max_steps=MAX_STEPS)
                sizes = StepSizes.of(settings.at(points.rate_tolerance), bound, points.until)
            costs[name] = method.step_cost * float(sizes.steps.mean())
        own = costs.pop(self.settings.method)
        return {name: cost / own for name, cost in costs.items()}

    @property
    def kernel(self) -> ModuleType:
        return specialization.kernel(self.system, self.settings.method, self.specialization, self.plugs)

    @property
    def tangent_kernel(self) -> ModuleType:
        return specialization.tangent_kernel(self.system, self.specialization)

    @property
    def kernel_hash(self) -> str:
        """Hash of the kernel and, if points may need tangent vectors, of the kernel with tangent vectors."""
        source, terms = specialization.source, self.specialization
        texts = [source(self.system, self.settings.method, terms, self.plugs)]
        if self.has_tangent:
            from ..kernel import tangent

            texts.append(source(self.system, TANGENT_METHOD.name, terms, of=tangent))
        return specialization.kernel_hash(*texts)


def method_lines(method: str, costs: Mapping[str, float]) -> list[str]:
    """Return a sentence on the cost of each other method. `costs` is the result of `Plan.relative_costs`."""
    return [
        f'method: {method}; method = "{name}" would integrate in about {ratio:.2g}'
        f" {'of' if ratio < 1 else 'times'} the time at the same tolerance"
        for name, ratio in costs.items()
    ]
