"""Find, describe and register systems by name."""

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
    """Map names to systems. Built-in systems are imported on first access; `get` and `register` add others."""

    def __getitem__(self, name: str) -> System:
        if self.data[name] is None:
            self.data[name] = getattr(import_module(f".{name}", __name__), name.upper())
        system: System = self.data[name]
        return system


SYSTEMS = _Systems(dict.fromkeys(BUILT_IN))
_ORIGINS: dict[System, plugins.Origin] = {}


def __getattr__(name: str) -> Any:
    """Return the function `name` that an extension adds to this module."""
    if function := extension.load("functions", f"systems.{name}"):
        return function
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}{extension.not_loaded()}")


def register(system: System | type[System]) -> System:
    """Make a system available to scenes and functions of this process under its name.

    A system registered earlier under the same name is replaced. Other processes, such as the shell command and dask
    workers, find a system only through the entry point `atlas.systems` of an installed package.

    Parameters
    ----------
    system : System or subclass of System
        A class is instantiated.

    Returns
    -------
    System
        The registered object, whose equations have been completed.

    Raises
    ------
    BadInput
        If the system has a mistake, which the message names, or if a built-in system has the same name.
    """
    return _register(system, "")


def _register(system: Any, package: str, name: str = "") -> System:
    """Register a system. `package` is the installed package and `name` its entry point; both may be empty."""
    from . import plugins
    from .check import check, check_complete, check_start

    kind = system if isinstance(system, type) else type(system)
    key = f"system = {shown(name)} of {package}" if package else f"register({kind.__name__})"
    try:
        if isinstance(system, type) and issubclass(system, System):
            check_complete(system)
            system = system()
        new = not hasattr(getattr(system, "equations", None), "SOURCES")  # registration sets SOURCES
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
            # The constants are counted first, because `completed` may append TIME_UNIT.
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
    except Exception as error:  # code of the system's author, such as __init__, may raise anything
        raise BadInput(f"{key}: {type(error).__name__}: {one_line(error)}") from None
    SYSTEMS[system.name] = system
    return system


def get(name: object) -> System:
    """Return the system called `name` and import it if needed. Raise BadInput if it is missing or broken."""
    if isinstance(name, str):
        if name in SYSTEMS:
            return SYSTEMS[name]
        from . import plugins

        installed = plugins.load(name)
        if installed is not None:
            return _register(*installed, name)
    raise BadInput(f"system = {shown(name)}: there is no such system; {allowed_text(name, names())}")


def names() -> list[str]:
    """Return the names of all built-in, registered and installed systems without importing any of them."""
    from . import plugins

    return list(dict.fromkeys([*SYSTEMS, *plugins.names()]))


def describe(name: str | None = None) -> str:
    """Return a text that describes one system with its parameters and families, or that lists all systems."""
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
    """Return all systems by name. A broken installed system is left out, and a warning is logged."""
    systems = {}
    for name in names():
        try:
            systems[name] = get(name)
        except BadInput as error:
            logging.getLogger("atlas").warning("%s", error)
    return systems


def origin(system: System) -> plugins.Origin | None:
    """Return the origin of a system, registered or not, or None for a built-in system."""
    if system not in _ORIGINS and not (system.name in BUILT_IN and SYSTEMS.get(system.name) is system):
        from . import plugins

        _ORIGINS[system] = plugins.origin(system, "")
    return _ORIGINS.get(system)
