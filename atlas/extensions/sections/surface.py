"""Surfaces of section: smooth functions of the state that vanish on them."""

from __future__ import annotations

import re
from functools import cached_property
from typing import Any

import numpy as np

from ...errors import BadInput, allowed_text, shown
from ...scene.expressions import Expression
from ...systems.arithmetic import TIME_UNIT
from ...systems.base import Array, Mask, System
from ...systems.jacobian import STEP

DIRECTIONS = {"rising": 1, "falling": -1, "either": 0}
ANGLES = ("psi", "phi")
BODY = ("theta", "phi", "theta_dot", "psi_dot", "phi_dot", "normal_rate", "axis_z")
FRAME = ("psi", "axis_x", "axis_y")  # those that need a vector at rest in the frame


def names_of(system: System) -> list[str]:
    """Names of the quantities that follow from a state and the constants."""
    equations = system.equations
    names = [*equations.STATE, *(name for name in equations.CONSTANTS if name != TIME_UNIT)]
    body = [*BODY, *(FRAME if hasattr(equations, "axis_in_frame") else ())] if system.frame else []
    return list(dict.fromkeys([*names, *(each.name for each in system.observables), *body]))


class Quantities(dict[str, Any]):
    """Quantities at states by name, each computed when it is asked for; states may be complex."""

    def __init__(self, system: System, state: Any, constants: Array):
        self.equations, self.at, self.of_body = system.equations, (state, constants), bool(system.frame)
        super().__init__(zip(self.equations.CONSTANTS, constants, strict=True))
        self.update(zip(self.equations.STATE, state, strict=True))

    @cached_property
    def motion(self) -> Any:
        """Angular velocity and vertical in body axes."""
        return self.equations.frame_motion(*self.at)

    def __missing__(self, name: str) -> Any:
        if self.of_body and name in (*FRAME, *BODY):
            x, y = self.equations.axis_in_frame(*self.at) if name in FRAME else (0.0, 0.0)
            u1, u2, u3, g1, g2, g3 = self.motion
            sin2, along = g1 * g1 + g2 * g2, u1 * g1 + u2 * g2
            # By name, so that no other is computed.
            self[name] = {
                "theta": lambda: _angle(np.sqrt(sin2), g3), "phi": lambda: _angle(g1, g2),
                "psi": lambda: _angle(x, -y), "theta_dot": lambda: (u1 * g2 - u2 * g1) / np.sqrt(sin2),
                "psi_dot": lambda: along / sin2, "phi_dot": lambda: u3 - along / sin2 * g3,
                "normal_rate": lambda: along + u3 * g3, "axis_x": lambda: x, "axis_y": lambda: y, "axis_z": lambda: g3,
            }[name]()  # fmt: skip
        else:
            self[name] = getattr(self.equations, name)(*self.at)
        return self[name]


def _angle(y: Any, x: Any) -> Any:
    """The angle of a point, of complex ones to first order in the imaginary parts."""
    angle = np.arctan2(np.real(y), np.real(x))
    if not np.iscomplexobj(y):
        return angle
    return angle + 1j * (y.imag * x.real - x.imag * y.real) / (x.real**2 + y.real**2)


class Surface:
    """A surface from a text such as "psi_dot = 0 rising"; BadInput for any other text."""

    def __init__(self, system: System, at: str):
        self.system, self.names, self.text = system, names_of(system), at
        equation, _, word = at.strip().rpartition(" ")
        if word not in DIRECTIONS:
            equation, word = at, "rising"
        self.direction, (left, _, right) = DIRECTIONS[word], equation.partition("=")
        try:
            sides = [Expression("at", side) for side in (left, right)]
        except BadInput:
            raise BadInput(
                f'at = {shown(at)}: allowed: two expressions with = between them, then "rising", "falling" or "either", such as'
                f' "{names_of(system)[0]} = 0 rising"'
            ) from None
        self.left, self.right = (self.expression(f"at = {shown(at)}", each.text) for each in sides)
        if re.search(r"\babs\(", at):
            raise BadInput(f"at = {shown(at)}: abs is not smooth; allowed: smooth functions")
        variable = {*self.names} - {*system.equations.CONSTANTS}
        if variable.isdisjoint(self.left.names | self.right.names):
            raise BadInput(
                f"at = {shown(at)}: no quantity of the motion; {allowed_text('', sorted(variable))}"
            )
        of_body = bool(system.frame) and self.left.text in (*ANGLES, *BODY[:5])
        # The quantity alone on the left, whose equation is free of the division by sin(theta).
        self.cleared = self.left.text if of_body and variable.isdisjoint(self.right.names) else ""
        jumping = (self.left.names | self.right.names) & {*ANGLES} if system.frame else set()
        if jumping - {self.cleared}:
            raise BadInput(
                f"at = {shown(at)}: psi and phi jump by a turn; allowed: one of them alone, as in"
                f' "{min(jumping)} = 0", or sines and cosines by axis_x, axis_y and states'
            )

    def expression(self, key: str, text: str) -> Expression:
        """An expression of these quantities, else BadInput."""
        expression = Expression(key, text)
        for name in sorted(expression.names - {*self.names}):
            raise BadInput(f"{key}: {shown(name)} is unknown; {allowed_text(name, sorted(self.names))}")
        return expression

    def value(self, state: Any, constants: Array) -> Any:
        """The function that vanishes on the surface and increases in the direction "rising"."""
        quantities = Quantities(self.system, state, constants)
        c = self.right.value(quantities)
        if not self.cleared:
            return self.left.value(quantities) - c
        u1, u2, u3, g1, g2, g3 = quantities.motion
        sin2, along = g1 * g1 + g2 * g2, u1 * g1 + u2 * g2
        return {
            "theta": lambda: np.cos(c) * np.sqrt(sin2 + g3 * g3) - g3,  # whatever rounding makes of the unit vector
            "theta_dot": lambda: u1 * g2 - u2 * g1 - c * np.sqrt(sin2), "psi_dot": lambda: along - c * sin2,
            "phi_dot": lambda: (u3 - c) * sin2 - along * g3, "phi": lambda: g1 * np.cos(c) - g2 * np.sin(c),
            "psi": lambda: quantities["axis_x"] * np.cos(c) + quantities["axis_y"] * np.sin(c),
        }[self.cleared]()  # fmt: skip

    def with_slope(self, state: Array, constants: Array) -> tuple[Array, Array]:
        """The function and its derivative by time, over the places of the states."""
        with np.errstate(all="ignore"):
            slope = np.array(np.broadcast_arrays(*self.system.equations.rhs(state, constants), state[0])[:-1])
            value, moved = (self.value(each, constants) for each in (state, state + 1j * STEP * slope))
        return np.broadcast_to(value, state.shape[1:]), np.broadcast_to(
            np.imag(moved) / STEP, state.shape[1:]
        )

    def size(self, state: Array, constants: Array) -> Array:
        """About the change of the function where all states change by their sizes."""
        shares = np.cos(np.arange(len(state)))[:, None]  # not all alike, which unit vectors would not feel
        return np.asarray(np.abs(np.imag(self.value(state * (1 + 1j * STEP * shares), constants))) / STEP)

    def contains(self, quantities: Quantities) -> Mask | bool:
        """Whether a zero is on the surface: of a jumping angle, those half a turn away are not."""
        if self.cleared not in ANGLES:
            return True
        return np.asarray(np.cos(quantities[self.cleared] - self.right.value(quantities)) > 0)
