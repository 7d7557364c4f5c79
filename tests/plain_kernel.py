"""Kernels as plain, slow Python: a debugger or a coverage tool steps through `integrate` in its own file."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Collection, Mapping
from functools import reduce
from operator import add
from types import ModuleType

import numpy as np

from atlas.kernel import augmented, generated, integrate
from atlas.kernel.assemble import (
    MEASURING,
    entries,
    file_of,
    generated_functions,
    generated_numbers,
    reachable,
)
from atlas.kernel.ensemble import Plug
from atlas.kernel.tableaux import METHODS
from atlas.systems import arithmetic


def plain_module(
    equations: ModuleType,
    method: str,
    zero: Collection[str] = (),
    equal: Mapping[str, str] = {},
    *,
    of: ModuleType = integrate,
    plugs: tuple[Plug, ...] = (),
) -> ModuleType:
    """The kernel of `assemble.source`, from the same arguments, as a module of plain Python."""
    measured = augmented.losses_of(equations, zero, equal) if file_of(of) in MEASURING else {}
    equations = augmented.with_losses(equations, measured)
    namespace = {"np": np, "axpy": _axpy, "aligned_empty": np.empty, **arithmetic.numpy_functions()}
    for name, text in generated_functions(equations, METHODS[method], zero, equal, of, plugs).items():
        exec(compile(text, f"<{name} of {equations.__name__}>", "exec"), namespace)
    objects, _, _ = reachable(entries(of, plugs))
    namespace |= {plug.add_node.__name__: plug.add_node for plug in plugs if plug.add_node}
    namespace |= generated_numbers(equations, METHODS[method], of, plugs)
    for shared in {function.__module__ for function in objects.values()} - {of.__name__}:
        values = vars(sys.modules[shared]).values()
        if any(getattr(value, "__module__", "") == generated.__name__ for value in values):
            copy = _copy(sys.modules[shared], namespace)
            namespace |= {name: getattr(copy, name) for name in objects if objects[name].__module__ == shared}
    module = _copy(of, namespace)
    # Compiled code raises no floating-point warnings.
    vars(module)["integrate"] = np.errstate(all="ignore")(module.integrate)
    return module


def _axpy(y, weights, slopes):
    """The tuple y plus the weighted sum of other tuples."""
    products = ([weight * value for value in slope] for weight, slope in zip(weights, slopes, strict=True))
    return tuple(value + reduce(add, column) for value, *column in zip(y, *products, strict=True))


def _copy(module: ModuleType, namespace: Mapping[str, object]) -> ModuleType:
    """A module executed again, with other values of some of its names."""
    copy = ModuleType(f"{module.__name__}_plain")
    vars(copy).update(__package__=module.__package__)
    exec(compile(inspect.getsource(module), inspect.getfile(module), "exec"), vars(copy))
    vars(copy).update(namespace)
    return copy
