"""Write atlas/faces.pyi: what the extensions of this package add to `atlas` and `ds.atlas`, for type checkers and editors."""

from __future__ import annotations

import ast
import inspect
import sys
from pathlib import Path
from types import FunctionType

from atlas import extension

ROOT = Path(__file__).parents[2]
STUB = ROOT / "atlas" / "faces.pyi"
HEAD = '"""Written by scripts/tools/make_faces.py; do not edit."""\n'


def imports_of(function: FunctionType) -> set[str]:
    """Import statements for the names in the annotations of a function, absolute, one name each."""
    module = inspect.getmodule(function)
    assert module is not None
    assert module.__file__ is not None
    tree = ast.parse(Path(module.__file__).read_text(encoding="utf-8"))
    annotations = [ast.parse(str(annotation)) for annotation in function.__annotations__.values()]
    used = {node.id for each in annotations for node in ast.walk(each) if isinstance(node, ast.Name)}
    statements = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef) and node.name in used:
            statements.add(f"from {module.__name__} import {node.name}")
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            if isinstance(target, ast.Name) and target.id in used and node in tree.body:
                statements.add(f"from {module.__name__} import {target.id}")
        elif isinstance(node, ast.Import):
            statements |= {
                f"import {each.name} as {each.asname}" if each.asname else f"import {each.name}"
                for each in node.names
                if (each.asname or each.name) in used
            }
        elif isinstance(node, ast.ImportFrom):
            above = module.__name__.split(".")[: -node.level] if node.level else []
            source = ".".join([*above, *([node.module] if node.module else [])])
            statements |= {
                f"from {source} import {each.name}"
                for each in node.names
                if (each.asname or each.name) in used
            }
    return statements


def declaration(function: FunctionType, name: str, method: bool) -> str:
    """The line that declares a function, or a method, whose first parameter, the dataset, becomes self."""
    signature = inspect.signature(function)
    if method:
        own = inspect.Parameter("self", inspect.Parameter.POSITIONAL_OR_KEYWORD)
        signature = signature.replace(parameters=[own, *list(signature.parameters.values())[1:]])
    return f"def {name}{signature}: ..."


def stub() -> str:
    """Text of the stub file."""
    parts = {
        kind: {
            name: extension.load(kind, name)
            for name, (each, _) in sorted(extension.parts(kind).items())
            if each.package.startswith("atlas.") and "." not in name
        }
        for kind in ("functions", "questions")
    }
    imports = {"import xarray as xr"}
    for function in (*parts["functions"].values(), *parts["questions"].values()):
        imports |= imports_of(function)
    names = list(parts["functions"])
    lines = [*sorted(imports), "", f"__all__ = {names!r}", ""]
    lines += [declaration(function, name, False) for name, function in parts["functions"].items()]
    lines += ["", "class Questions:", "    _ds: xr.Dataset"]
    lines += ["    " + declaration(function, name, True) for name, function in parts["questions"].items()]
    return HEAD + "\n".join(lines) + "\n"


if __name__ == "__main__":
    text = stub()
    if sys.argv[1:] == ["--check"]:
        sys.exit(text != STUB.read_text(encoding="utf-8"))
    STUB.write_text(text, encoding="utf-8")
