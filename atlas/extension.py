"""Extensions, which add parts to the core. Installed packages name their extensions in entry points of the group `atlas.extensions`."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from . import sources
from .errors import BadInput, allowed_text, one_line

GROUP = "atlas.extensions"
# "module:name" of an object in the package of an `Extension`
Reference = str


@dataclass(frozen=True, eq=False)
class Extension:
    """The parts that a package adds to the core. Each part is imported on use.

    An entry point with the name of the extension refers to an `Extension`. Parts are references, "module:name", to modules inside
    `package`.

    Parameters
    ----------
    name : str
        Name of the extension, and of its entry point.
    package : str
        Package that contains the modules, such as ``__name__`` of the module that makes the object.
    title : str
        What the extension adds, in a few words.
    needs : sequence of str, optional
        Names of extensions that this one needs; if one is missing, this extension is left out.
    functions : mapping of str to str, optional
        Public name below `atlas` -> function.
    questions : mapping of str to str, optional
        Name of a method of ``ds.atlas`` -> function whose first argument is the dataset.
    commands : mapping of str to str, optional
        Name of a command of the shell -> object made by `atlas.cli.options.command`.
    variables : mapping of str to str, optional
        Name of a variable from theory -> function of a system that returns `DerivedVariable` objects by name, none if they
        have no meaning for the system.
    instruments : mapping of str to str, optional
        Name of a measured variable -> `atlas.measure.instrument.Instrument` object that measures the variable.
    methods : mapping of str to str, optional
        Name of a method of `System` that asks extensions -> function of the system and the arguments of the method. The
        function returns None if it has no answer.
    families : mapping of str to str, optional
        Name of a family of steady motions -> function of a system that returns `Family` objects by name; their flags follow
        the flags of the system's own families.
    lines : mapping of str to str, optional
        Name of a variable -> function that returns, by kind, all lines on maps of this variable. Its arguments are a
        `Plane` (of one or two axes) and the dataset.
    flag_texts : mapping of str to str, optional
        Name of a variable -> function of a dataset that returns texts of the variable's flags for the legends of maps.
    line_styles : mapping of str to str, optional
        Kind of line -> Matplotlib's color, linestyle and linewidth; without them lines are thin and black.
    stress_cases : mapping of str to str, optional
        Name of a system -> function of the system that returns more stress cases; several extensions may have such functions.
    formats : mapping of str to str, optional
        Suffix of a file, in lower case -> `Format` of `atlas.store.finished` that writes and reads atlases with this suffix.
    published : mapping of str to str, optional
        Name of a system -> sequence of `PublishedEquation`, rows of its catalogue; several extensions may have such rows.
    published_numbers : mapping of str to str, optional
        Name of a system -> function that takes the name and returns rows of printed numbers; several extensions may have such rows.
    """

    name: str
    package: str
    title: str
    needs: Sequence[str] = ()
    functions: Mapping[str, Reference] = field(default_factory=dict)
    questions: Mapping[str, Reference] = field(default_factory=dict)
    commands: Mapping[str, Reference] = field(default_factory=dict)
    variables: Mapping[str, Reference] = field(default_factory=dict)
    instruments: Mapping[str, Reference] = field(default_factory=dict)
    methods: Mapping[str, Reference] = field(default_factory=dict)
    families: Mapping[str, Reference] = field(default_factory=dict)
    lines: Mapping[str, Reference] = field(default_factory=dict)
    flag_texts: Mapping[str, Reference] = field(default_factory=dict)
    line_styles: Mapping[str, Reference] = field(default_factory=dict)
    stress_cases: Mapping[str, Reference] = field(default_factory=dict)
    formats: Mapping[str, Reference] = field(default_factory=dict)
    published: Mapping[str, Reference] = field(default_factory=dict)
    published_numbers: Mapping[str, Reference] = field(default_factory=dict)

    @property
    def folder(self) -> Path:
        """The folder of the extension's modules."""
        return Path(import_module(self.package).__path__[0])

    @property
    def code(self) -> str:
        """Hash of the modules of this extension and of needed extensions, taken when a part was first loaded."""
        own = sources.of_folder(self.folder)
        return sources.code(own | {name: (0, extensions()[name].code) for name in self.needs})

    def load(self, reference: Reference) -> Any:
        """Return the object that a reference names. Raise BadInput with one line if the module cannot be imported."""
        module, _, name = reference.partition(":")
        try:
            sources.of_folder(self.folder)
            return getattr(import_module(f"{self.package}.{module}"), name)
        except BadInput:
            raise
        except Exception as error:  # the code of an extension may raise anything
            why = _found()[1][self.name] = f"{type(error).__name__}: {one_line(error)}"
            raise BadInput(f"the extension {self.name} cannot be loaded ({why})") from error


# Kinds of parts, which are the fields that map names to references.
PARTS = tuple(
    each.name for each in fields(Extension) if each.name not in ("name", "package", "title", "needs")
)
# Each part of these kinds has the name of a system. Several extensions may have a part for the same system; see `of_each`.
OF_SYSTEMS = ("stress_cases", "published", "published_numbers")


@cache
def _found() -> tuple[dict[str, Extension], dict[str, str]]:
    """Return the extensions by name, in alphabetical order, and the reason for each extension that cannot be loaded."""
    extensions, broken = {}, {}
    for entry in sorted(entry_points(group=GROUP), key=lambda entry: entry.name):
        try:
            record = entry.load()
            if not isinstance(record, Extension) or record.name != entry.name:
                raise TypeError(f"{entry.value} is no Extension of this name")
            extensions[record.name] = record
        except Exception as error:  # the code of an extension may raise anything
            broken[entry.name] = f"{type(error).__name__}: {one_line(error)}"
    return extensions, broken


def extensions() -> Mapping[str, Extension]:
    """Return the extensions of all installed packages by name. An extension that needs a missing extension is left out."""
    available, broken = dict(_found()[0]), _found()[1]
    while lacking := [(e, name) for e in available.values() for name in e.needs if name not in available]:
        for each, name in lacking:
            available.pop(each.name, None)
            broken[each.name] = f"it needs the extension {name}, which is missing"
    return available


def not_loaded() -> str:
    """Return the end of a message about an unknown name. The text lists the extensions that cannot be loaded."""
    return "".join(f"; the extension {name} cannot be loaded ({why})" for name, why in _found()[1].items())


def available_text(value: object, names: Collection[str]) -> str:
    """Return the end of a message about an unknown name. The text lists the allowed `names`, then the extensions that cannot be loaded."""
    return f"{allowed_text(value, names)}{not_loaded()}"


@cache
def parts(kind: str) -> Mapping[str, tuple[Extension, Reference]]:
    """Return every part of a kind (one of PARTS) by name. Raise BadInput if two parts share a name, unless `kind` is in OF_SYSTEMS."""
    by_name: dict[str, tuple[Extension, Reference]] = {}
    for extension in extensions().values():
        for name, reference in getattr(extension, kind).items():
            if name in by_name and kind not in OF_SYSTEMS:
                raise BadInput(
                    f"{name} is among the {kind} of two extensions, {by_name[name][0].name} and {extension.name}: remove one"
                )
            by_name[name] = extension, reference
    return by_name


def load(kind: str, name: str) -> Any:
    """Return a part by its kind and name, or None if no extension has the part."""
    if name not in parts(kind):
        return None
    extension, reference = parts(kind)[name]
    return extension.load(reference)


def of_each(kind: str, system: str) -> list[Any]:
    """Return the parts of a kind for a system, from all extensions. Raise BadInput if one of the parts cannot be loaded."""
    given = [(each, getattr(each, kind)) for each in extensions().values()]
    return [each.load(of_system[system]) for each, of_system in given if system in of_system]


def every(kind: str, among: Callable[[str], bool] = bool) -> list[Any]:
    """Return the different objects of a kind (one of PARTS), in the order of extensions.

    Only parts whose names satisfy `among` are imported. Parts that cannot be loaded are left out.
    """
    objects = []
    for extension, reference in dict.fromkeys(part for name, part in parts(kind).items() if among(name)):
        with suppress(BadInput):  # not_loaded() tells the reason
            objects.append(extension.load(reference))
    return objects


def used(variables: Iterable[str], families: Iterable[str]) -> list[Extension]:
    """Return the extensions that give any of the variables or families, in alphabetical order."""
    given = [parts(kind).get(name) for kind in ("variables", "instruments") for name in variables]
    given += [parts("families").get(name) for name in families]
    names = {part[0].name for part in given if part}
    return [extension for name, extension in extensions().items() if name in names]
