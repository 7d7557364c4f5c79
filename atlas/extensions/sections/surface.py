"""Surfaces of section, as zeros of smooth functions of the state."""

from __future__ import annotations

import re
from collections.abc import Collection
from typing import Any

import numpy as np

from ...errors import BadInput, allowed_text, shown
from ...label.trajectory import attributes_of
from ...scene.expressions import Expression
from ...systems.arithmetic import TIME_UNIT
from ...systems.base import Array, Mask, System
from ...systems.jacobian import STEP

DIRECTIONS = {"rising": 1, "falling": -1, "either": 0}
JUMPING = {"psi", "phi"}  # angles that jump by a turn
OF_FRAME = {"psi", "axis_x", "axis_y"}  # quantities that need `axis_in_frame`
STEEP = {"theta", "theta_dot", "psi_dot", "phi_dot"}  # quantities that are not smooth on the vertical
TINY = 1e-300  # keeps rates finite if the axis is on the vertical


def quantities(system: System, names: Collection[str], state: Any, constants: Array) -> dict[str, Any]:
    """Return the named quantities, the states and the constants. States with tiny imaginary parts give exact derivatives (complex step)."""
    equations = system.equations
    values = dict(zip((*equations.CONSTANTS, *equations.STATE), (*constants, *state), strict=True))
    missing = {*names} - values.keys()
    if not system.frame:
        return values | {name: getattr(equations, name)(state, constants) for name in missing}
    u1, u2, u3, g1, g2, g3 = equations.frame_motion(state, constants)
    sine2 = g1 * g1 + g2 * g2 + TINY
    of_body = {
        "theta": lambda: _angle(np.sqrt(sine2), g3),
        "psi": lambda: _angle(*_sine_and_cosine(system, "psi", state, constants)),
        "phi": lambda: _angle(g1, g2),
        "theta_dot": lambda: (u1 * g2 - u2 * g1) / np.sqrt(sine2),
        "psi_dot": lambda: (u1 * g1 + u2 * g2) / sine2,
        "phi_dot": lambda: u3 - (u1 * g1 + u2 * g2) / sine2 * g3,
        "normal_rate": lambda: u1 * g1 + u2 * g2 + u3 * g3,
        "axis_x": lambda: equations.axis_in_frame(state, constants)[0],
        "axis_y": lambda: equations.axis_in_frame(state, constants)[1],
        "axis_z": lambda: g3,
    }
    return values | {name: of_body[name]() for name in missing}


def _angle(sine: Any, cosine: Any) -> Any:
    """Return the angle of a sine and a cosine, which may have a common factor. Tiny imaginary parts give exact derivatives."""
    y, x = np.real(sine), np.real(cosine)
    return np.arctan2(y, x) + 1j * (np.imag(sine) * x - np.imag(cosine) * y) / (x * x + y * y)


def _sine_and_cosine(system: System, angle: str, state: Any, constants: Array) -> tuple[Any, Any]:
    """Return sine and cosine of psi or phi, each times sin theta, because these products are smooth on the vertical."""
    if angle == "phi":
        return system.equations.frame_motion(state, constants)[3:5]
    x, y = system.equations.axis_in_frame(state, constants)
    return x, -y


class Surface:
    """A surface from a text such as "psi_dot = 0 rising". Any other text raises BadInput."""

    def __init__(self, system: System, at: str):
        equations, key = system.equations, f"at = {shown(at)}"
        absent = OF_FRAME if system.frame and not hasattr(equations, "axis_in_frame") else set()
        moving = attributes_of(system).keys() - absent - {"integral_drift"}
        self.system, self.known = system, moving | {*equations.CONSTANTS} - {TIME_UNIT}
        equation, _, word = at.strip().rpartition(" ")
        if word not in DIRECTIONS:
            equation, word = at, "rising"
        self.direction, (left, _, right) = DIRECTIONS[word], equation.partition("=")
        try:
            self.left, self.right = (Expression("at", side) for side in (left, right))
        except BadInput:
            raise BadInput(
                f'{key}: allowed: two expressions with = between them, then "rising", "falling" or "either", such as'
                f' "{equations.STATE[0]} = 0 rising"'
            ) from None
        self.names = {*self.checked(key, self.left).names, *self.checked(key, self.right).names}
        if re.search(r"\babs\(", at):
            raise BadInput(f"{key}: abs is not smooth; allowed: smooth functions")
        if moving.isdisjoint(self.names):
            raise BadInput(f"{key}: no quantity of the motion; {allowed_text('', sorted(moving))}")
        # If an angle stands alone on the left side, a smooth equation of its sine and cosine replaces the given equation.
        alone = system.frame and moving.isdisjoint(self.right.names)
        self.angle = self.left.text if alone and self.left.text in {"theta", *JUMPING} else ""
        if system.frame and (jumping := self.names & JUMPING - {self.angle}):
            raise BadInput(
                f'{key}: psi and phi jump by a turn; allowed: one of them alone, as in "{min(jumping)} = 0", or sines and'
                " cosines by axis_x, axis_y and states"
            )
        # Near the vertical theta' changes sign, psi' and phi' peak, and theta is least. A factor sin(theta)^power smooths the function.
        steep = self.names & STEEP if system.frame else set()
        self.power = 0 if not steep else 1 if steep == {"theta_dot"} else 2

    def checked(self, key: str, expression: Expression) -> Expression:
        """Return the expression, or raise BadInput if it contains an unknown name."""
        for name in sorted(expression.names - self.known):
            raise BadInput(f"{key}: {shown(name)} is unknown; {allowed_text(name, sorted(self.known))}")
        return expression

    def value(self, state: Any, constants: Array) -> Any:
        """Return the value of the function that is 0 on the surface and increases at crossings in the direction "rising"."""
        values = quantities(self.system, self.names - {self.angle}, state, constants)
        c = self.right.value(values)
        if self.angle == "theta":
            return np.cos(c) - self.system.equations.frame_motion(state, constants)[5]
        if self.angle:
            sine, cosine = _sine_and_cosine(self.system, self.angle, state, constants)
            return sine * np.cos(c) - cosine * np.sin(c)
        value = self.left.value(values) - c
        if not self.power:
            return value
        g1, g2 = _sine_and_cosine(self.system, "phi", state, constants)
        sine2 = g1 * g1 + g2 * g2 + TINY
        return value * (sine2 if self.power == 2 else np.sqrt(sine2))

    def with_slope(self, state: Array, slopes: Array, constants: Array) -> tuple[Array, Array]:
        """Return the function at states, and its derivative when the states have the derivatives `slopes`."""
        with np.errstate(all="ignore"):
            value = np.broadcast_to(self.value(state + 1j * STEP * slopes, constants), state.shape[1:])
        return value.real, value.imag / STEP

    def contains(self, state: Array, constants: Array) -> Mask | bool:
        """Whether a zero of `value` is on the surface. For psi and phi, `value` is also 0 half a turn away from the surface."""
        if self.angle not in JUMPING:
            return True
        values = quantities(self.system, {self.angle}, state, constants)
        return np.asarray(np.cos(values[self.angle].real - self.right.value(values)) > 0)
