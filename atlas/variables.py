"""The only registry of dataset variables, which writer, validator, labels, command line, docs and tests read."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from functools import lru_cache
from types import MappingProxyType

from . import extension
from .errors import BadInput
from .measure.chaos import Chaos
from .measure.circle import CIRCLES
from .measure.instrument import Instrument, MainInstrument, Variable
from .measure.observables import Observables
from .measure.rates import Rates
from .systems.base import NATURAL_RATE, System, derived_variables, time_units

# Instruments of the core, in the order of variables in a file. The first that measures a system is the main instrument.
INSTRUMENTS: list[Instrument] = [Rates(), Observables(), *CIRCLES, Chaos()]
# Dimension of an atlas of points that are not on axes.
POINT = "point"
# Variables from theory alone, which also have values where a point is not integrated.
PREDICTED = {"predicted", "predicted_inertial", "family", "stable", "growth_rate", "condition_residual"}
# Variable of refined atlases, in which not every point is integrated.
COMPUTED = Variable(
    "computed", "int8", "1", "where the labels come from",
    {
        "interpolated": "labels of the points around, which are all the same",
        "computed": "integrated, or without motion of the family",
    },
)  # fmt: skip


def instruments() -> tuple[Instrument, ...]:
    """Return the instruments of the core and then those of extensions."""
    return (*INSTRUMENTS, *extension.every("instruments"))


def is_theory(system: System, name: str) -> bool:
    """Return whether a variable comes from theory alone and so has values where a point is not integrated."""
    proofs = (each.variables(system) for each in instruments() if each.proofs_of)
    listed = PREDICTED | derived_variables(system).keys() | {v.name for part in proofs for v in part}
    return name in listed or name.startswith("predicted_")


def is_measured(system: System, name: str) -> bool:
    """Return whether a variable has numbers only at points that are integrated."""
    return not is_theory(system, name) and data_variables(system)[name].dtype.startswith("float")


def proofs_of_labels(system: System | None = None) -> dict[str, str]:
    """Return the variable that proves each label of one or all systems. The variable is not 0 where the label holds for every duration."""
    proofs = {label: proof for each in instruments() for label, proof in each.proofs_of.items()}
    if system is None:
        return proofs
    registry = variables(system)
    return {label: proof for label, proof in proofs.items() if proof in registry}


def main_instrument(system: System) -> MainInstrument:
    """Return the instrument whose kernel integrates a system."""
    mains = (each for each in INSTRUMENTS if isinstance(each, MainInstrument))
    return next(each for each in mains if each.variables(system))


def data_variables(system: System) -> dict[str, Variable]:
    """Return every data variable that a dataset of the system may have. Coordinates must not have these names."""
    return {**variables(system), COMPUTED.name: COMPUTED}


def variables(system: System) -> Mapping[str, Variable]:
    """Return the variables of an atlas of the system in the order of the file. Raise BadInput if names clash."""
    return _registry(system, instruments())


@lru_cache(maxsize=64)  # a run calls this function some thirty times
def _registry(system: System, instruments: tuple[Instrument, ...]) -> Mapping[str, Variable]:
    """Return the variables of instruments and of theory by name. Raise BadInput if names clash."""
    listed = [variable for each in instruments for variable in each.variables(system)] + [
        Variable(
            d.name, "int8" if d.flags else "float64", d.unit, d.long_name, dict(d.flags) if d.flags else None,
            comment=d.comment, optional=True,
        )
        for d in derived_variables(system).values()
    ]  # fmt: skip
    registry = {v.name: replace(v, units=time_units(system, v.units)) for v in listed}
    if len(registry) < len(listed):
        names = [variable.name for variable in listed]
        repeated = next(name for name in names if names.count(name) > 1)
        raise BadInput(
            f"the system {system.name}: two variables of its atlases would be called {repeated}; rename one"
        )
    every = {variable.name for each in instruments for variable in each.every_variable(system)}
    reserved = {*registry, *every, COMPUTED.name, POINT, "time", NATURAL_RATE}
    for kind, names in (
        ("parameter", list(system.parameters)),
        ("observable", [o.name for o in system.observables]),
    ):
        for name in names:
            if name in reserved:
                raise BadInput(
                    f"the system {system.name}: its {kind} {name} has the name of a variable of the atlas; choose another name"
                )
    return MappingProxyType(registry)


def listed_variables(system: System, names: Collection[str]) -> list[str]:
    """Return `names` and the variables that are always stored beside them, in the order of the file."""
    registry = variables(system)
    beside = {registry[name].beside for name in names if name in registry}
    return [name for name in registry if name in names or name in beside]


def default_variables(system: System) -> list[str]:
    """Return the names of the variables that an atlas holds by default, in the order of the file."""
    return [name for name, variable in variables(system).items() if not variable.optional]
