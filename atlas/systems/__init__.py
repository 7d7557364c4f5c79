"""Systems by name: equations, parameters, start values, families, and the theory of the gyrostat."""

from __future__ import annotations

import logging
from collections import UserDict
from importlib import import_module
from typing import TYPE_CHECKING, Any

from .. import extension
from ..errors import BadInput, allowed_text, one_line, shown, text_table
from . import arithmetic
from .base import Observable, Parameter, System, families_of

if TYPE_CHECKING:
    from . import plugins

__all__ = [
    "BUILT_IN",
    "SYSTEMS",
    "Observable",
    "Parameter",
    "System",
    "available",
    "describe",
    "from_lagrangian",
    "get",
    "names",
    "origin",
    "register",
]

BUILT_IN = ("satellite", "fixed_point")


class _Systems(UserDict[str, Any]):
    """Systems by name: built-in ones are imported on first access, others are added by `get` and `register`."""

    def __getitem__(self, name: str) -> System:
        if self.data[name] is None:
            self.data[name] = getattr(import_module(f".{name}", __name__), name.upper())
        system: System = self.data[name]
        return system


SYSTEMS = _Systems(dict.fromkeys(BUILT_IN))
_ORIGINS: dict[System, plugins.Origin] = {}


def __getattr__(name: str) -> Any:
    """A function that an extension adds to this module."""
    if function := extension.load("functions", f"systems.{name}"):
        return function
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}{extension.not_loaded()}")


def register(system: System | type[System]) -> System:
    """Make a system available to scenes and functions of this process under its name.

    It replaces a system registered earlier under this name. Other processes, such as the shell command and dask workers,
    find a system by the entry point `atlas.systems` of an installed package.

    Parameters
    ----------
    system : System or subclass of System
        A class is instantiated.

    Returns
    -------
    System
        The object, with completed equations.

    Raises
    ------
    BadInput
        If the system has a mistake, which the message names, or the name of a built-in system.
    """
    return _register(system, "")


def _register(system: Any, package: str, name: str = "") -> System:
    """Register a system; package, name: the installed package that has it and the name of its entry point, or empty."""
    from . import plugins
    from .check import check, check_complete, check_start

    kind = system if isinstance(system, type) else type(system)
    key = f"system = {shown(name)} of {package}" if package else f"register({kind.__name__})"
    try:
        if isinstance(system, type) and issubclass(system, System):
            check_complete(system)
            system = system()
        new = not hasattr(getattr(system, "equations", None), "SOURCES")  # otherwise it is registered already
        if new:
            check(system)
        if system.name in BUILT_IN and not package:
            raise BadInput(
                f"name = {shown(system.name)}: a system of this package has this name; choose another one"
            )
        if package and system.name != name:
            raise BadInput(f"its name is {shown(system.name)}; the name of the entry point must be the same")
        if new:
            _ORIGINS[system] = plugins.origin(system, package)
            # `completed` adds missing functions and TIME_UNIT, the kernels' unit of time as a constant.
            given = len(getattr(system.equations, "CONSTANTS", ()))
            observables = [observable.name for observable in system.observables]
            system.equations = arithmetic.completed(system.equations, observables)
            if strobed := tuple(o.name for o in system.observables if o.every is not None):
                system.equations.STROBED = strobed
                system.equations.OBSERVABLES = tuple(name for name in observables if name not in strobed)
            if system.observables:
                system.frame = ""
            if len(system.equations.CONSTANTS) > given and type(system).constants is not System.constants:
                vars(system)["constants"] = arithmetic.with_unit_row(system.constants)
        check_start(system)
    except BadInput as error:
        raise BadInput(f"{key}: {error}") from None
    except Exception as error:  # raised by the author's code, such as __init__
        raise BadInput(f"{key}: {type(error).__name__}: {one_line(error)}") from None
    SYSTEMS[system.name] = system
    return system


def get(name: object) -> System:
    """The system of this name, imported from its package if needed; BadInput if there is none or it is broken."""
    if isinstance(name, str):
        if name in SYSTEMS:
            return SYSTEMS[name]
        from . import plugins

        installed = plugins.load(name)
        if installed is not None:
            return _register(*installed, name)
    raise BadInput(f"system = {shown(name)}: there is no such system; {allowed_text(name, names())}")


def names() -> list[str]:
    """Names of all systems: of this package, registered, and installed; nothing is imported."""
    from . import plugins

    return list(dict.fromkeys([*SYSTEMS, *plugins.names()]))


def describe(name: str | None = None) -> str:
    """A system with its parameters and families, or all systems in a line each, as text to print."""
    if name is None:
        return text_table([(key, system.title) for key, system in available().items()])
    system = get(name)
    parameters = [(n, p.unit, f"{p.default:g}", p.meaning) for n, p in system.parameters.items()]
    families = [
        (n, f"solves {', '.join(f.solve) or 'nothing'}", f.title) for n, f in families_of(system).items()
    ]
    frame = f"; frame: {system.frame_text}" if system.frame_text else ""
    return "\n".join(
        [f"{name}: {system.title}{frame}", text_table(parameters), text_table(families or [("no families",)])]
    )


def available() -> dict[str, System]:
    """All systems by name; installed but broken systems are left out with a logged warning."""
    systems = {}
    for name in names():
        try:
            systems[name] = get(name)
        except BadInput as error:
            logging.getLogger("atlas").warning("%s", error)
    return systems


def origin(system: System) -> plugins.Origin | None:
    """Origin of a system, registered or not; None for a built-in one."""
    if system not in _ORIGINS and not (system.name in BUILT_IN and SYSTEMS.get(system.name) is system):
        from . import plugins

        _ORIGINS[system] = plugins.origin(system, "")
    return _ORIGINS.get(system)
