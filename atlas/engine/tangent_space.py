"""Tangent vectors of a system: their components, and the right-hand side of the variational equations.

The equations may name vectors that are at rest in the frame (`FRAME_VECTORS`: body-axes components of unit
vectors v with v' = v x u, u the angular velocity relative to the frame). Where there are two or more, a
change of the attitude is a rotation by a small vector eta of the body's axes: dv = v x eta, and

    eta' = du + eta x u,

by the Jacobi identity. Three components thus replace the components of all vectors, whose lengths and
products are kept. Everything else changes by components of its own.
"""

from __future__ import annotations

from types import ModuleType

import numpy as np

from ..systems.base import Array
from .differentiate import PREFIX, differential

# Start of a tangent vector, for the state and for the rotation: out of every plane of symmetry, not normalised.
START, START_OF_ROTATION = (5.0, -4.0, 6.0), (3.0, 4.0, -3.0)


def frame_vectors(equations: ModuleType) -> tuple[tuple[str, str, str], ...]:
    """Triples of states that are vectors at rest in the frame."""
    return getattr(equations, "FRAME_VECTORS", ())


def rotates(equations: ModuleType) -> bool:
    """Whether the tangent vector contains a rotation instead of the changes of the frame's vectors."""
    return len(frame_vectors(equations)) > 1


def own_components(equations: ModuleType) -> list[int]:
    """Indices of the states that change by components of their own."""
    rotated = (
        {name for vector in frame_vectors(equations) for name in vector} if rotates(equations) else set()
    )
    return [i for i, name in enumerate(equations.STATE) if name not in rotated]


def size(equations: ModuleType) -> int:
    return len(own_components(equations)) + (3 if rotates(equations) else 0)


def variation(equations: ModuleType, rhs: str) -> dict[str, str]:
    """Sources, by name, of ``rhs_change(state, constants, change)``, and of ``variation(state, constants,
    tangent)``, the time derivative of the tangent vector.
    """
    own, names = own_components(equations), list(equations.STATE)
    changes = [f"t{j}" for j in range(len(own))]
    lines = [f"{', '.join(names)}, = state"]
    if rotates(equations):
        lines.append(f"{', '.join([*changes, 'e1', 'e2', 'e3'])}, = tangent")
        change = {names[i]: f"t{j}" for j, i in enumerate(own)}
        for x, y, z in frame_vectors(equations):
            change |= {x: f"{y} * e3 - {z} * e2", y: f"{z} * e1 - {x} * e3", z: f"{x} * e2 - {y} * e1"}
        lines.append(f"change = ({', '.join(change[name] for name in names)},)")
        slopes = [f"{PREFIX}{i}" for i in range(len(names))]
        lines += [
            f"{', '.join(slopes)}, = rhs_change(state, constants, change)",
            "u1, u2, u3, v1, v2, v3 = frame_motion(state, constants)",
            "du1, du2, du3, dv1, dv2, dv3 = frame_motion(change, constants)",  # it is linear
        ]
        rotation = ["du1 + e2 * u3 - e3 * u2", "du2 + e3 * u1 - e1 * u3", "du3 + e1 * u2 - e2 * u1"]
        lines.append(f"return ({', '.join([*(slopes[i] for i in own), *rotation])},)")
    else:
        lines.append("return rhs_change(state, constants, tangent)")
    return {
        "rhs_change": differential(rhs, "rhs_change"),
        "variation": "\n    ".join(["def variation(state, constants, tangent):", *lines]),
    }


def start(equations: ModuleType, state: Array) -> Array:
    """Tangent vectors of norm 1 at the start, (size, points), rates in the unit of rates of their norm.

    A single vector of the frame changes by its product with the start of the rotation, to stay a unit vector.
    """
    names, own = list(equations.STATE), own_components(equations)
    pattern = (*START, *START_OF_ROTATION)
    vectors = frame_vectors(equations)
    values = dict.fromkeys(names, 0.0) | {
        names[i]: pattern[j % len(START if vectors else pattern)] for j, i in enumerate(own)
    }
    rows = [np.full(state.shape[1], values[names[i]]) for i in own]
    if rotates(equations):
        rows += [np.full(state.shape[1], value) for value in START_OF_ROTATION]
    elif vectors:
        indices = [names.index(name) for name in vectors[0]]
        for i, row in zip(indices, np.cross(state[indices].T, START_OF_ROTATION).T, strict=True):
            rows[own.index(i)] = row
    tangent = np.array(rows)
    return np.ascontiguousarray(tangent / np.sqrt((tangent * tangent).sum(0)))
