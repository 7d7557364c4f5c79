"""Docstrings of the public face follow numpydoc; the list of checks is in pyproject.toml."""

import inspect
import tomllib
from functools import cached_property
from pathlib import Path
from types import FunctionType

import pytest
from numpydoc.validate import validate

import atlas
from atlas import extension
from atlas.accessor import Atlas
from atlas.systems.base import System

ROOT = Path(__file__).parent.parent
CHECKS = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["numpydoc_validation"]["checks"])
FUNCTIONS = (
    "concat",
    "figure",
    "label_points",
    "load_scene",
    "example",
    "open_atlas",
    "register",
    "run",
    "style",
    "trajectory",
)
SYSTEM = "atlas.systems.base.System."
FACES = ("functions", "questions")  # parts of extensions


def is_in_class_docstring(code: str, message: str) -> bool:
    """Whether an error concerns what the docstring of System describes for all its methods.

    That is `points`, their only argument in most cases, and a single array as the result, which a summary describes.
    """
    return code == "RT01" or (code, message) == ("PR01", "Parameters {'points'} not documented")


def public_members(owner: type) -> list[str]:
    """Full names of the public methods and properties that a class defines."""
    kinds = (FunctionType, property, cached_property, classmethod, staticmethod)
    return [
        f"{owner.__module__}.{owner.__name__}.{name}"
        for name, member in vars(owner).items()
        if not name.startswith("_") and isinstance(member, kinds)
    ]


def test_the_list_of_functions_is_complete():
    functions = {name for name in atlas.__all__ if inspect.isfunction(getattr(atlas, name))}
    assert functions - extension.parts("functions").keys() == set(FUNCTIONS)


@pytest.mark.parametrize(
    "name",
    [
        *(f"atlas.{name}" for name in FUNCTIONS),
        *(
            f"{each.package}.{part.replace(':', '.')}"
            for kind in FACES
            for each, part in extension.parts(kind).values()
        ),
        *public_members(Atlas),
        *public_members(System),
    ],
)
def test_docstring_has_the_sections_of_numpydoc(name):
    errors = [
        f"{code}: {message}"
        for code, message in validate(name)["errors"]
        if code in CHECKS
        and not (name.startswith(SYSTEM) and is_in_class_docstring(code, message))
        and message != "Parameters {'ds'} not documented"  # the dataset of a question
    ]
    assert not errors, f"{name}:\n" + "\n".join(errors)


@pytest.mark.parametrize("owner", [Atlas, System])
def test_classes_have_docstrings(owner):
    assert inspect.getdoc(owner)
