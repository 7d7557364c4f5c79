"""Check systems that users write. The message about a mistake is one line."""

from __future__ import annotations

import keyword
import math
import re
from collections.abc import Mapping

import numpy as np

from ..errors import BadInput, shown
from . import arithmetic
from .base import Observable, Parameter, System

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,59}")
_BY_EQUATIONS = "the equations and their FRAME_VECTORS decide which starts are steady motions"
# Names that no system may have, with a text for messages that says what replaces the name.
REPLACED = {
    "paper": "the rows of a paper are `published` of an extension",
    "complete": _BY_EQUATIONS,
    "complete_any_axis": _BY_EQUATIONS,
    "any_axis_rates": f"{_BY_EQUATIONS}; those of a family are its axes",
    "condition_residual": f"{_BY_EQUATIONS}; the unit of the residual is the frequency bound",
    "squared_rate": "the unit of condition_residual is the frequency bound, of a Gyrostat the root of its squared_unit",
    "growth_about_vertical": "it follows from the equations and their FRAME_VECTORS",
    "rough_stability": "rough_stability of a Family says which growth rates need few digits",
    "log_growth": "growth over a run is the growth rate of linear_stability times its duration, or more of a Gyrostat",
    "rate_unit": "the unit of rates in tangent vectors is the frame_rate, or 1",
    "geometry": "`geometries` contains objects of Geometry, which say by `holds` which motions have it",
    "published": "the rows of a paper are `published` of an extension",
    "possible_body": "moments_of_inertia names the parameters that the triangle inequality is about",
    "check_possible": "possible_start and start_condition say which starts are possible",
    "equal_parameters": "specialization receives every pair of parameters that are equal at all points",
    "reserved_families": "`families` of an extension, whose flags follow those of the system",
    "within_range": "theory makes no prediction where parameters are beyond 1e60",
    "despun_equivalent": "`despun` of a Gyrostat",
}
# Largest number of characters in the name of a parameter. Names that a scene defines have the same limit.
MAX_NAME = 60


def check(system: object) -> None:
    """Raise BadInput with a message of one line unless `system` is a system that the package can use."""
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
    if "constants" not in vars(system) and type(system).constants is System.constants:
        for name in getattr(system.equations, "CONSTANTS", ()):
            if name not in system.parameters:
                raise BadInput(
                    f"equations: the constant {name} is no parameter, and the system has no method constants"
                )


def check_complete(kind: type[System], system: System | None = None) -> None:
    """Raise BadInput if a class, or the object `system`, lacks a required member or has a name in REPLACED."""
    for name in ("name", "title", "equations", "parameters", "initial_state"):
        if not hasattr(system or kind, name) or name in kind.__abstractmethods__:
            raise BadInput(f"{kind.__name__}.{name} is missing")
    for name, instead in REPLACED.items():
        if hasattr(system or kind, name):
            raise BadInput(f"{kind.__name__}.{name} is no member of a system: {instead}")


def check_start(system: System) -> None:
    """Raise BadInput unless a system can be evaluated at default parameters. The equations come from `arithmetic.completed`."""
    defaults = {name: np.full(2, parameter.default) for name, parameter in system.parameters.items()}
    equations = system.equations
    shapes = {"initial_state": (len(equations.STATE), 2), "constants": (len(equations.CONSTANTS), 2)}
    for name, shape in (shapes | {"frequency_bound": (2,)}).items():
        try:
            with np.errstate(all="ignore"):
                values = np.asarray(getattr(system, name)(defaults), float)
        except Exception as error:  # the author's code may raise anything
            text = f"{type(error).__name__}: {' '.join(str(error).split())}"
            raise BadInput(f"{name} fails at the defaults of the parameters: {text}") from None
        if values.shape != shape:
            raise BadInput(f"{name} has the shape {values.shape} for 2 points; allowed: {shape}")


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
        _check_unit_and_text(key, parameter.unit, ".meaning", parameter.meaning)
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
        _check_unit_and_text(key, observable.unit, ": long_name", observable.long_name)
        tolerance = observable.tolerance
        if tolerance is not None and not (isinstance(tolerance, int | float) and tolerance > 0):
            raise BadInput(f"{key}: tolerance = {shown(tolerance)}: must be a number above 0, or None")
    every = {str(observable.every) for observable in observables if observable.every is not None}
    if len(every) > 1:
        raise BadInput(f"observables: every = {', '.join(sorted(every))}: allowed: one time for all of them")
    for text in every:
        constants = dict.fromkeys(getattr(system.equations, "CONSTANTS", ()), np.ones(1))
        arithmetic.value("observables: every", text, constants)
        if all(observable.every is not None for observable in observables):
            raise BadInput(
                f"observables: every = {text}: one at least must be measured throughout, without it"
            )
    if observables and all(observable.tolerance == math.inf for observable in observables):
        raise BadInput("observables: the tolerance of each is infinite; one at least must decide the label")


def _check_name(key: str, name: object) -> None:
    if not isinstance(name, str) or not name.isascii() or not name.isidentifier() or len(name) > MAX_NAME:
        raise BadInput(
            f"{key}: {shown(name)} cannot be a name; allowed: at most {MAX_NAME} letters, digits and _"
        )
    if keyword.iskeyword(name) or name in arithmetic.FUNCTIONS or name in ("abs", "pi"):
        raise BadInput(f"{key}: {shown(name)} has another meaning in expressions; choose another name")


def _check_unit_and_text(key: str, unit: object, name: str, text: object) -> None:
    if not is_unit(unit):
        raise BadInput(
            f'{key}: {shown(unit)} is no unit; allowed: such as "kg m2", "rad s-1", and "1" for pure numbers'
        )
    if not isinstance(text, str) or not text:
        raise BadInput(f"{key}{name} = {shown(text)}: must be a text")


# Units of parameters and observables are products of powers of UDUNITS units, such as "kg m2 s-1". The units in _PREFIXED
# take prefixes, and the units in _PLAIN take none.
_PREFIXED = (
    "m g s A K mol cd Hz N Pa J W C V F ohm S Wb T H rad sr eV bar L l lm lx Bq Gy t meter metre gram second ampere kelvin"
    " mole candela hertz newton pascal joule watt coulomb volt farad siemens weber tesla henry radian steradian liter"
    " litre"
)
_PLAIN = (
    "min minute h hr hour d day year yr deg degree arcmin arcminute arcsec arcsecond percent % au turn revolution rpm"
    " degree_C degC ppm light_year parsec lb ft inch mile knot atm mmHg"
)
_PREFIXES = "y z a f p n u m c d da h k M G T P E Z Y nano micro milli centi deci hecto kilo mega giga tera"
UNITS = {*_PREFIXED.split(), *_PLAIN.split()}
UNITS |= {prefix + unit for prefix in _PREFIXES.split() for unit in _PREFIXED.split()}
_FACTOR = re.compile(
    r"(?P<number>\d+\.?\d*(?:[eE][-+]?\d+)?)|(?P<name>[A-Za-z_%]+)(?:(?:\^|\*\*)?(?P<power>[-+]?\d+))?"
)
_BETWEEN = re.compile(r"\s*[*./]\s*|\s+|$")


def is_unit(text: object) -> bool:
    """Return whether a text is a unit in the spelling of UDUNITS. The unit of pure numbers is "1"."""
    if not isinstance(text, str) or not text:
        return False
    position = 0
    while position < len(text):
        factor = _FACTOR.match(text, position)
        if factor is None:
            return False
        name = factor["name"]
        if name is not None and name not in UNITS and not (len(name) > 4 and name.removesuffix("s") in UNITS):
            return False
        between = _BETWEEN.match(text, factor.end())
        if between is None or (between.end() == len(text) and between[0]):
            return False
        position = between.end()
    return True
