"""Surfaces of section: smooth functions of the state that vanish on them."""

from __future__ import annotations

import re
from collections.abc import Collection
from typing import Any

import numpy as np

from ...errors import BadInput, allowed_text, shown
from ...scene.expressions import Expression
from ...systems.arithmetic import TIME_UNIT
from ...systems.base import Array, Mask, System
from ...systems.jacobian import STEP

DIRECTIONS = {"rising": 1, "falling": -1, "either": 0}
ANGLES = ("theta", "psi", "phi")  # the last two jump by a turn
RATES = ("theta_dot", "psi_dot", "phi_dot")
FRAME = ("psi", "axis_x", "axis_y")  # those that need a vector at rest in the frame
BODY = {*ANGLES, *RATES, *FRAME, "normal_rate", "axis_z"}


def names_of(system: System) -> list[str]:
    """Names of the quantities that follow from a state and the constants."""
    equations, body = system.equations, BODY if system.frame else set()
    names = [*equations.STATE, *(name for name in equations.CONSTANTS if name != TIME_UNIT)]
    body = body if hasattr(equations, "axis_in_frame") else body - {*FRAME}
    return list(dict.fromkeys([*names, *(each.name for each in system.observables), *body]))


def quantities(system: System, names: Collection[str], state: Any, constants: Array) -> dict[str, Any]:
    """These quantities, and the states and constants, at states, which may be complex."""
    values = dict(zip(system.equations.CONSTANTS, constants, strict=True))
    values |= zip(system.equations.STATE, state, strict=True)
    for name in {*names} - values.keys():
        if system.frame and name in BODY:
            a, b = _parts(system, name, state, constants)
            if name not in ANGLES:
                values[name] = a / b
            else:  # only theta is asked for at complex states
                values[name] = np.arccos(b) if np.iscomplexobj(b) else np.arctan2(a, b)
        else:
            values[name] = getattr(system.equations, name)(state, constants)
    return values


def _parts(system: System, name: str, state: Any, constants: Array) -> tuple[Any, Any]:
    """Numerator and denominator of a quantity of a body, of an angle sine and cosine times a factor."""
    if name in FRAME:
        x, y = system.equations.axis_in_frame(state, constants)
        return {"psi": (x, -y), "axis_x": (x, 1.0), "axis_y": (y, 1.0)}[name]
    u1, u2, u3, g1, g2, g3 = system.equations.frame_motion(state, constants)
    sin2, along = g1 * g1 + g2 * g2, u1 * g1 + u2 * g2
    return {
        "theta": (np.sqrt(sin2), g3), "phi": (g1, g2), "theta_dot": (u1 * g2 - u2 * g1, np.sqrt(sin2)),
        "psi_dot": (along, sin2), "phi_dot": (u3 * sin2 - along * g3, sin2), "normal_rate": (along + u3 * g3, 1.0),
        "axis_z": (g3, 1.0),
    }[name]  # fmt: skip


class Surface:
    """A surface from a text such as "psi_dot = 0 rising"; BadInput for any other text."""

    def __init__(self, system: System, at: str):
        self.system, self.known, key = system, names_of(system), f"at = {shown(at)}"
        equation, _, word = at.strip().rpartition(" ")
        if word not in DIRECTIONS:
            equation, word = at, "rising"
        self.direction, (left, _, right) = DIRECTIONS[word], equation.partition("=")
        try:
            self.left, self.right = (Expression("at", side) for side in (left, right))
        except BadInput:
            raise BadInput(
                f'{key}: allowed: two expressions with = between them, then "rising", "falling" or "either", such as'
                f' "{self.known[0]} = 0 rising"'
            ) from None
        self.names = {*self.checked(key, self.left).names, *self.checked(key, self.right).names}
        if re.search(r"\babs\(", at):
            raise BadInput(f"{key}: abs is not smooth; allowed: smooth functions")
        variable = {*self.known} - {*system.equations.CONSTANTS}
        if variable.isdisjoint(self.names):
            raise BadInput(f"{key}: no quantity of the motion; {allowed_text('', sorted(variable))}")
        # The quantity alone on the left, whose equation is free of the division by sin(theta).
        alone = system.frame and variable.isdisjoint(self.right.names)
        self.cleared = self.left.text if alone and self.left.text in (*ANGLES, *RATES) else ""
        if system.frame and (jumping := self.names & {*ANGLES[1:]} - {self.cleared}):
            raise BadInput(
                f'{key}: psi and phi jump by a turn; allowed: one of them alone, as in "{min(jumping)} = 0", or sines and'
                " cosines by axis_x, axis_y and states"
            )

    def checked(self, key: str, expression: Expression) -> Expression:
        """The expression; BadInput if it has other names than these quantities."""
        for name in sorted(expression.names - {*self.known}):
            raise BadInput(f"{key}: {shown(name)} is unknown; {allowed_text(name, sorted(self.known))}")
        return expression

    def value(self, state: Any, constants: Array) -> Any:
        """The function that vanishes on the surface and increases in the direction "rising"."""
        values = quantities(self.system, self.names - {self.cleared}, state, constants)
        c = self.right.value(values)
        if not self.cleared:
            return self.left.value(values) - c
        a, b = _parts(self.system, self.cleared, state, constants)
        if self.cleared == "theta":  # smooth on the vertical
            return np.cos(c) * np.sqrt(a * a + b * b) - b
        return a * np.cos(c) - b * np.sin(c) if self.cleared in ANGLES else a - c * b

    def with_slope(self, state: Array, constants: Array) -> tuple[Array, Array, Array]:
        """The function and its derivative by time over the places of the states, and the derivatives of the states."""
        with np.errstate(all="ignore"):
            slopes = np.array(
                np.broadcast_arrays(*self.system.equations.rhs(state, constants), state[0])[:-1]
            )
            moved = self.value(state + 1j * STEP * slopes, constants)
            both = self.value(state, constants), np.imag(moved) / STEP
        value, slope = (np.broadcast_to(each, state.shape[1:]) for each in both)
        return value, slope, slopes

    def size(self, state: Array, constants: Array) -> Array:
        """About the change of the function where all states change by their sizes."""
        shares = np.cos(np.arange(len(state)))[:, None]  # not all alike, which unit vectors would not feel
        return np.asarray(np.abs(np.imag(self.value(state * (1 + 1j * STEP * shares), constants))) / STEP)

    def contains(self, state: Array, constants: Array) -> Mask | bool:
        """Whether a zero is on the surface: of a jumping angle, those half a turn away are not."""
        if self.cleared not in ANGLES[1:]:
            return True
        values = quantities(self.system, {*self.names, self.cleared}, state, constants)
        return np.asarray(np.cos(values[self.cleared] - self.right.value(values)) > 0)
