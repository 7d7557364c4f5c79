"""Kernels of a system, which are compiled once for each method and each set of vanishing terms, and then cached."""

from __future__ import annotations

from collections.abc import Set
from dataclasses import dataclass
from functools import cache
from types import ModuleType
from typing import Any

from ..systems import arithmetic
from ..systems.base import System
from . import assemble, integrate
from .ensemble import Plug
from .tableaux import TANGENT_METHOD


@dataclass(frozen=True)
class Specialization:
    """Terms that the kernel of a whole scene may leave out."""

    zero: frozenset[str] = frozenset()  # constants of the equations that are 0 at every point
    equal: frozenset[tuple[str, str]] = frozenset()  # pairs of constants that are equal at every point

    @classmethod
    def of(cls, system: System, zero: Set[str], equal: Set[tuple[str, str]]) -> Specialization:
        """Return the specialization for parameters that are 0 or absent, and pairs of parameters that are equal, at all points."""
        zero_constants, equal_constants = system.specialization(zero, equal)
        return cls(frozenset(zero_constants), frozenset(equal_constants))


GENERIC = Specialization()


@cache
def source(
    system: System,
    method: str,
    specialization: Specialization = GENERIC,
    plugs: tuple[Plug, ...] = (),
    of: ModuleType | None = None,
) -> str:
    """Return the source of a system's kernel. `of` is the template, such as `integrate`, and `plugs` are instruments in the kernel."""
    if of is None and system.observables:
        from . import observe as of
    zero, equal = specialization.zero, dict(specialization.equal)
    with arithmetic.PARSING:
        return assemble.source(system.equations, method, zero, equal, of=of or integrate, plugs=plugs)


@cache
def kernel(
    system: System, method: str, specialization: Specialization = GENERIC, plugs: tuple[Plug, ...] = ()
) -> ModuleType:
    """Return the module that integrates a system. The kernel is compiled, or taken from the cache, at the first call."""
    return _jit().load(source(system, method, specialization, plugs))


@cache
def tangent_kernel(system: System, specialization: Specialization = GENERIC) -> ModuleType:
    """Return the module that integrates a system with a tangent vector."""
    from . import tangent

    return _jit().load(source(system, TANGENT_METHOD.name, specialization, of=tangent))


@cache
def node_kernel(system: System, method: str, specialization: Specialization = GENERIC) -> ModuleType:
    """Return the module that computes states of a system along motions, without statistics."""
    from . import nodes

    return _jit().load(source(system, method, specialization, of=nodes))


@cache
def slope_kernel(system: System) -> ModuleType:
    """Return the module that computes the slopes for reference solutions."""
    from . import quadratures

    return _jit().load(source(system, TANGENT_METHOD.name, of=quadratures))


@cache
def kernel_hash(*sources: str) -> str:
    """Return a hash of the sources of kernels, the compilers and the architecture. Every atlas records such a hash."""
    return "-".join(map(_jit().numeric_digest, sources))


def _jit() -> Any:
    """Return the compiler. It is imported here because reading and drawing atlases does not need a compiler."""
    from . import machine_code

    return machine_code
