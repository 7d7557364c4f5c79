"""Checks of input values. A check returns the value or raises BadInput with one line. Many checks have a JSON Schema."""

from __future__ import annotations

import dataclasses
import functools
import inspect
import math
import os
import re
from collections.abc import Callable, Collection, Mapping
from functools import partial
from numbers import Integral, Real
from typing import Any, Generic, TypeAlias, TypeVar

import numpy as np

from ..errors import BadInput, allowed_text, shown
from ..systems.base import Parameter
from .expressions import RESERVED, Expression

MAX_NAME = 60  # largest number of characters of a name chosen by the user
MAX_THREADS = 1024  # largest number of threads or processes of a run
MAX_LISTED_NUMBERS = 200_000  # largest number of numbers in a list of a scene

T = TypeVar("T")


@dataclasses.dataclass(frozen=True)
class Check(Generic[T]):
    """A function that checks a value, and the JSON Schema of the accepted values."""

    read: Callable[[str, Any], T]
    schema: dict[str, Any]

    def __call__(self, key: str, value: object) -> T:
        return self.read(key, value)


def accepts(**schema: Any) -> Callable[[Callable[[str, Any], T]], Check[T]]:
    """Return a decorator that turns a function into a check with the given schema."""
    return lambda read: Check(read, schema)


@accepts(type="number")
def number(key: str, value: object) -> float:
    """Return the value as a float. Raise BadInput unless the value is a finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise BadInput(f"{key} = {shown(value)}: must be a number")
    try:
        result = float(value)
    except OverflowError:
        result = math.inf
    if not math.isfinite(result):
        raise BadInput(f"{key} = {shown(value)}: must be a finite number")
    return result


@accepts(type=["number", "string"], pattern=rf"^([-+*/().0-9\s]|[0-9][eE]|{'|'.join(sorted(RESERVED))})+$")
def quantity(key: str, value: object) -> float:
    """Return the value as a float. Raise BadInput unless the value is a finite number or arithmetic such as "90 * deg"."""
    if not isinstance(value, str):
        return number(key, value)
    expression = Expression(key, value)
    for name in sorted(expression.names):
        raise BadInput(
            f"{key} = {shown(value)}: {name} has no value here; put what follows from other names into [ties]"
        )
    return number(key, float(expression.value({})))


@accepts(type="number", exclusiveMinimum=0)
def positive(key: str, value: object) -> float:
    """Return the value as a float. Raise BadInput unless the value is a finite number above 0."""
    result = number(key, value)
    if result <= 0:
        raise BadInput(f"{key} = {shown(value)}: must be a finite number above 0")
    return result


@accepts(type=["number", "string"], exclusiveMinimum=0)
def positive_at_points(key: str, value: object) -> float | str:
    """Return a value above 0 as a float. Arithmetic that contains names is returned as text, since the value is not known yet."""
    if not isinstance(value, str):
        return positive(key, value)
    expression = Expression(key, value)
    return expression.text if expression.names else positive(key, float(expression.value({})))


@accepts(type="object", additionalProperties=positive.schema)
def positive_numbers(key: str, value: object) -> dict[str, float]:
    """Return a table as floats by name. Raise BadInput unless the table contains only finite numbers above 0."""
    return {name: positive(f"{key}.{name}", each) for name, each in mapping(key, value).items()}


@accepts(type="number", exclusiveMinimum=0, maximum=1)
def at_most_one(key: str, value: object) -> float:
    """Return the value as a float. Raise BadInput unless the value is a number above 0 and at most 1."""
    result = positive(key, value)
    if result > 1:
        raise BadInput(f"{key} = {shown(value)}: must be above 0 and at most 1")
    return result


@accepts(type="number", minimum=0, maximum=1)
def fraction(key: str, value: object) -> float:
    """Return the value as a float. Raise BadInput unless the value is a number from 0 to 1."""
    result = number(key, value)
    if not 0 <= result <= 1:
        raise BadInput(f"{key} = {result:g}: must be a share of the points, from 0 to 1")
    return result


def whole_number(key: str, value: object, low: int, high: float = math.inf) -> int:
    """Return the value as an int. Raise BadInput unless the value is an integer from `low` to `high` and no Boolean."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not low <= value <= high:
        allowed = f", at least {low}" if high == math.inf else f" from {low} to {high}"
        raise BadInput(f"{key} = {shown(value)}: must be a whole number{allowed}")
    return int(value)


def whole(low: int, high: int) -> Check[int]:
    """Return a check for a `whole_number` from `low` to `high`."""
    schema = {"type": "integer", "minimum": low, "maximum": high}
    return Check(partial(whole_number, low=low, high=high), schema)


@accepts(type="boolean")
def boolean(key: str, value: object) -> bool:
    """Return the value. Raise BadInput unless the value is true or false."""
    if not isinstance(value, bool):
        raise BadInput(f"{key} = {shown(value)}: must be true or false")
    return value


@accepts(type="string")
def text(key: str, value: object) -> str:
    """Return the value. Raise BadInput unless the value is a string."""
    if not isinstance(value, str):
        raise BadInput(f"{key} = {shown(value)}: must be a string")
    return value


def choice(key: str, value: object, allowed: Collection[str]) -> str:
    """Return the value. Raise BadInput unless the value is one of the allowed strings."""
    if not isinstance(value, str) or value not in allowed:
        raise BadInput(f"{key} = {shown(value)}: {allowed_text(value, allowed)}")
    return value


def one_of(allowed: Collection[str]) -> Check[str]:
    """Return a check for a `choice` among the allowed strings."""
    return Check(partial(choice, allowed=allowed), {"type": "string", "enum": list(allowed)})


@accepts(anyOf=[text.schema, {"type": "array", "items": text.schema}])
def texts(key: str, value: object) -> tuple[str, ...]:
    """Return the value as a tuple of strings. Raise BadInput unless the value is a string or a list of strings."""
    if isinstance(value, list | tuple | set | frozenset) and all(isinstance(item, str) for item in value):
        return tuple(text(key, item) for item in value)
    if not isinstance(value, str):
        raise BadInput(f"{key} = {shown(value)}: must be a string or a list of strings")
    return (text(key, value),)


@accepts(type="array", items=number.schema, minItems=1)
def numbers(key: str, value: object) -> list[float]:
    """Return a list of floats. Raise BadInput unless the value is a list of at least one finite number."""
    if not isinstance(value, list) or not value:
        raise BadInput(f"{key} = {shown(value)}: must be a list of at least one number")
    if len(value) > MAX_LISTED_NUMBERS:
        raise BadInput(f"{key}: {len(value)} numbers; allowed: at most {MAX_LISTED_NUMBERS}")
    return [number(key, item) for item in value]


@accepts(**numbers.schema, uniqueItems=True)
def distinct_numbers(key: str, value: object) -> list[float]:
    """Return a list of floats. Raise BadInput unless the value is a list of at least one finite number, without equal numbers."""
    values = numbers(key, value)
    if len(set(values)) < len(values):
        raise BadInput(f"{key}: some values occur twice; an axis needs distinct values")
    return values


def identifier(key: str, name: str) -> str:
    """Return the name. Raise BadInput if the name cannot be used in ties."""
    if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name) or len(name) > MAX_NAME or name in RESERVED:
        raise BadInput(
            f"{key}: {shown(name)} cannot be used as a name; allowed: ASCII letters, digits and _, at most {MAX_NAME},"
            f" not beginning with a digit, and none of {', '.join(sorted(RESERVED))}"
        )
    return name


@accepts(type="object")
def mapping(key: str, value: object) -> Mapping[str, Any]:
    """Return the value. Raise BadInput unless the value is a table."""
    if not isinstance(value, Mapping):
        raise BadInput(f"{key} = {shown(value)}: must be a table, [{key}]")
    return value


def check_keys(table: Mapping[str, Any], parent: str, allowed: Collection[str]) -> None:
    """Raise BadInput if the table has a key that is not allowed. `parent` is the key of the table and a dot, for the message."""
    for key in table:
        if key not in allowed:
            raise BadInput(f"{parent}{key}: unknown key; {allowed_text(key, allowed)}")


def check_range(parameter: Parameter, key: str, low: float, high: float) -> None:
    """Raise BadInput if `low` or `high` is outside the range of the parameter."""
    below = low <= parameter.low if parameter.open_low else low < parameter.low
    if below or high > parameter.high:
        sign = ">" if parameter.open_low else ">="
        limit = f"{sign} {parameter.low:g}" if below else f"<= {parameter.high:g}"
        raise BadInput(
            f"{key} = {low if below else high:g}: allowed: {parameter.name} {limit} ({parameter.meaning})"
        )


# For each type in annotations of public functions, the classes that are accepted, and the words for the type in messages.
_TYPES: dict[str, tuple[tuple[type, ...], str]] = {
    "None": ((type(None),), "None"),
    "str": ((str,), "a text"),
    "bool": ((bool, np.bool_), "true or false"),
    "int": ((Integral,), "a whole number"),
    "float": ((Real,), "a number"),
    "Mapping": ((Mapping,), "a mapping"),
    "dict": ((Mapping,), "a mapping"),
    "tuple": ((tuple, list), "a tuple"),
    "Path": ((os.PathLike,), "a path"),
}
Annotated = TypeVar("Annotated", bound=Callable[..., Any])


def typed(target: Annotated) -> Annotated:
    """Make a function, or each public method of a class, raise BadInput for arguments of a type other than the annotated types."""
    if isinstance(target, type):
        for name, method in vars(target).copy().items():
            if inspect.isfunction(method) and not name.startswith("_"):
                setattr(target, name, typed(method))
        return target
    signature = inspect.signature(target)
    takes_listed = all(each.kind is not each.VAR_KEYWORD for each in signature.parameters.values())
    allowed = {}
    for name, parameter in signature.parameters.items():
        types = re.sub(r"\[.*\]", "", str(parameter.annotation)).split(" | ")
        if parameter.kind is not parameter.VAR_KEYWORD and set(types) <= set(_TYPES):
            allowed[name] = [_TYPES[each] for each in types]

    @functools.wraps(target)
    def checked_function(*arguments: Any, **options: Any) -> Any:
        unknown = [name for name in options if name not in signature.parameters]
        if unknown and takes_listed:
            names = [name for name in signature.parameters if name not in ("self", "ds")]
            raise BadInput(
                f"{target.__name__}: {unknown[0]}: no such option; {allowed_text(unknown[0], names)}"
            )
        for name, value in signature.bind(*arguments, **options).arguments.items():
            kinds = allowed.get(name)
            if kinds and not any(
                isinstance(value, classes) and (bool in classes or not isinstance(value, bool))
                for classes, _ in kinds
            ):
                words = " or ".join(words for _, words in kinds if words != "None")
                raise BadInput(f"{name} = {shown(value)}: must be {words}")
        return target(*arguments, **options)

    return checked_function  # type: ignore[return-value]


SEED = whole(0, 2**63 - 1)
SPACINGS = ("linear", "log")


def interval(key: str, table: Mapping[str, Any]) -> tuple[float, float, str]:
    """Return the ends and the spacing, "linear" or "log", of a table that was read with the keys of INTERVAL."""
    first, last, spacing = table["from"], table["to"], table.get("spacing", "linear")
    if spacing == "log" and not (first > 0 and last > 0):
        raise BadInput(f"{key}.spacing = 'log': from and to must be above 0, found {first:g} and {last:g}")
    extent = last / first if spacing == "log" else last - first
    if not (math.isfinite(extent) and (extent or first == last)):
        raise BadInput(f"{key}: from = {first:g} and to = {last:g} are too far apart")
    return first, last, spacing


Keys: TypeAlias = Mapping[str, "dataclasses.Field[Any]"]  # fields made by `checked`, by name


def checked(
    check: Check[Any], default: Any = dataclasses.MISSING, section: str = "", description: str = ""
) -> Any:
    """Return a dataclass field with a check. `section` is the table of the field, if a class is read from several tables."""
    metadata = {"check": check, "section": section, "description": description}
    return dataclasses.field(default=default, metadata=metadata)


INTERVAL: Keys = {
    "from": checked(quantity, description="first value"),
    "to": checked(quantity, description="last value"),
    "spacing": checked(one_of(SPACINGS), "linear"),
}


def keys_of(cls: type, section: str = "") -> Keys:
    """Return the `checked` fields of a class that are read from the table `section`, by name."""
    return {f.name: f for f in dataclasses.fields(cls) if f.metadata["section"] in ("", section)}


def instance_of(cls: type[T], table: Mapping[str, Any], section: str) -> T:
    """Return an instance of a class with `checked` fields, read by `from_table`."""
    return cls(**from_table(keys_of(cls), table, section))


def table_schema(fields: Keys, *, needed: bool = True) -> dict[str, Any]:
    """Return the JSON Schema of the table that `from_table` reads. With `needed`, keys without a default are required."""
    keys = {}
    for name, field in fields.items():
        keys[name] = dict(field.metadata["check"].schema)
        if field.metadata["description"]:
            keys[name]["description"] = field.metadata["description"]
        if isinstance(field.default, int | float | str) and field.default != "":
            keys[name]["default"] = field.default
    schema = {"type": "object", "additionalProperties": False, "properties": keys}
    required = [name for name, field in fields.items() if field.default is dataclasses.MISSING]
    return schema | {"required": required} if needed and required else schema


def from_table(
    fields: Keys, table: Mapping[str, Any], section: str, also: Collection[str] = (), rule: str = ""
) -> dict[str, Any]:
    """Return the checked values of a table. Keys in `also` are allowed but not read. `rule` tells a user which keys are needed."""
    check_keys(table, f"{section}.", [*also, *fields])
    needed = [name for name, field in fields.items() if field.default is dataclasses.MISSING]
    for name in needed:
        if name not in table:
            rule = rule or f"[{section}] needs {', '.join(needed)}"
            raise BadInput(f"{section}.{name} is missing: {rule}")
    return {
        name: field.metadata["check"](f"{section}.{name}", table[name])
        for name, field in fields.items()
        if name in table
    }
