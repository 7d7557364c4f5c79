"""What a system must be before anything uses it: every mistake of its author in one line."""

from __future__ import annotations

import keyword
import math
import re
from collections.abc import Mapping

import numpy as np

from ..errors import BadInput, shown
from . import arithmetic
from .base import Observable, Parameter, System
from .units import is_unit

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,59}")
# Characters of a parameter's name, as of the names that a scene makes up.
MAX_NAME = 60


def check(system: object) -> None:
    """Raise BadInput with one line unless an object is a system that the package can use."""
    if not isinstance(system, System):
        raise BadInput(f"found {shown(system)}: not an object of a subclass of atlas.systems.System")
    check_complete(type(system), system)
    if not isinstance(system.name, str) or not NAME.fullmatch(system.name):
        raise BadInput(f"name = {shown(system.name)}: allowed: at most 60 ASCII letters, digits, _ and -")
    if not isinstance(system.title, str) or not system.title:
        raise BadInput(f"title = {shown(system.title)}: must be a text")
    _check_parameters(system.parameters)
    _check_observables(system)
    arithmetic.check("equations", system.equations, [o.name for o in system.observables])
    if "constants" not in _members(system):
        for name in getattr(system.equations, "CONSTANTS", ()):
            if name not in system.parameters:
                raise BadInput(
                    f"equations: the constant {name} is no parameter, and the system has no method constants"
                )


def check_complete(kind: type[System], system: System | None = None) -> None:
    """Raise BadInput for the first member that a class, or an object of it, leaves out."""
    for name in ("name", "title", "equations", "parameters", "initial_state"):
        if not hasattr(system or kind, name) or name in kind.__abstractmethods__:
            raise BadInput(f"{kind.__name__}.{name} is missing")


def check_start(system: System) -> None:
    """Raise BadInput unless a system with completed equations works at the defaults of its parameters."""
    defaults = {name: np.full(2, parameter.default) for name, parameter in system.parameters.items()}
    equations = system.equations
    wanted = {"initial_state": len(equations.STATE), "constants": len(equations.CONSTANTS)}
    for name, rows in wanted.items():
        try:
            with np.errstate(all="ignore"):
                values = np.asarray(getattr(system, name)(defaults), float)
        except Exception as error:  # whatever its author's code raises
            raise BadInput(f"{name} fails at the defaults of the parameters: {_text(error)}") from None
        if values.shape != (rows, 2):
            raise BadInput(f"{name} has the shape {values.shape} for 2 points; allowed: ({rows}, 2)")
    try:
        with np.errstate(all="ignore"):
            bound = np.asarray(system.frequency_bound(defaults), float)
    except Exception as error:
        raise BadInput(f"frequency_bound fails at the defaults of the parameters: {_text(error)}") from None
    if bound.shape != (2,):
        raise BadInput(f"frequency_bound has the shape {bound.shape} for 2 points; allowed: (2,)")


def _text(error: BaseException) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


def _members(system: System) -> set[str]:
    """Names that the classes below `base.System` define."""
    classes = type(system).__mro__[: type(system).__mro__.index(System)]
    return {name for cls in classes for name in vars(cls)} | set(vars(system))


def _check_parameters(parameters: object) -> None:
    if not isinstance(parameters, Mapping) or not parameters:
        raise BadInput(
            f"parameters = {shown(parameters)}: must be a mapping of names to Parameter, not empty"
        )
    for name, parameter in parameters.items():
        if not isinstance(parameter, Parameter):
            raise BadInput(f"parameters.{name} = {shown(parameter)}: must be a Parameter")
        key = f"parameters.{name}"
        if parameter.name != name:
            raise BadInput(f"{key} has the name {shown(parameter.name)}: both must be the same")
        _check_name(key, name)
        _check_unit(key, parameter.unit)
        _check_text(f"{key}.meaning", parameter.meaning)
        default, low, high = parameter.default, parameter.low, parameter.high
        if not all(isinstance(x, int | float) for x in (default, low, high)) or not low < high:
            raise BadInput(
                f"{key}: low = {shown(low)}, high = {shown(high)}: must be numbers, low below high"
            )
        below = default <= low if parameter.open_low else default < low
        if math.isinf(default) or below or default > high:
            interval = f"{'above' if parameter.open_low else 'from'} {low:g}, at most {high:g}"
            raise BadInput(f"{key}: the default {default:g} is outside its range; allowed: {interval}")


def _check_observables(system: System) -> None:
    observables = system.observables
    if not isinstance(observables, tuple | list) or not all(isinstance(o, Observable) for o in observables):
        raise BadInput(f"observables = {shown(observables)}: must be a tuple of Observable")
    if observables and hasattr(system.equations, "frame_motion"):
        raise BadInput(
            "observables and frame_motion of the equations are both given; a system has one of them"
        )
    if observables:
        for name in ("families", "frame_rate", "moments_of_inertia"):
            if getattr(system, name):
                raise BadInput(f"{name}: only for systems with frame_motion, and this one has observables")
    names = [observable.name for observable in observables]
    for observable in observables:
        key = f"observables: {observable.name}"
        _check_name(key, observable.name)
        if names.count(observable.name) > 1:
            raise BadInput(f"{key} is named twice")
        if observable.name in system.parameters:
            raise BadInput(f"{key}: a parameter has this name; choose another one")
        _check_unit(key, observable.unit)
        _check_text(f"{key}: long_name", observable.long_name)
        tolerance = observable.tolerance
        if tolerance is not None and not (isinstance(tolerance, int | float) and tolerance > 0):
            raise BadInput(f"{key}: tolerance = {shown(tolerance)}: must be a number above 0, or None")
    if observables and all(observable.tolerance == math.inf for observable in observables):
        raise BadInput("observables: the tolerance of each is infinite; one at least must decide the label")


def _check_name(key: str, name: object) -> None:
    if not isinstance(name, str) or not name.isascii() or not name.isidentifier() or len(name) > MAX_NAME:
        raise BadInput(
            f"{key}: {shown(name)} cannot be a name; allowed: at most {MAX_NAME} letters, digits and _"
        )
    if keyword.iskeyword(name) or name in arithmetic.FUNCTIONS or name in ("abs", "pi"):
        raise BadInput(f"{key}: {shown(name)} has another meaning in expressions; choose another name")


def _check_unit(key: str, unit: object) -> None:
    if not is_unit(unit):
        raise BadInput(
            f'{key}: {shown(unit)} is no unit; allowed: such as "kg m2", "rad s-1", and "1" for pure numbers'
        )


def _check_text(key: str, text: object) -> None:
    if not isinstance(text, str) or not text:
        raise BadInput(f"{key} = {shown(text)}: must be a text")
