"""Write double_pendulum/equations.py: python write_equations.py"""

from pathlib import Path

import sympy as sp

from atlas.systems import from_lagrangian

angle1, angle2, rate1, rate2, m1, m2, l1, l2, g = sp.symbols("angle1 angle2 rate1 rate2 m1 m2 l1 l2 g")
x1, y1 = l1 * sp.sin(angle1), -l1 * sp.cos(angle1)
x2, y2 = x1 + l2 * sp.sin(angle2), y1 - l2 * sp.cos(angle2)


def velocity(expression):
    return expression.diff(angle1) * rate1 + expression.diff(angle2) * rate2


def kinetic(mass, x, y):
    return sp.trigsimp(mass / 2 * sp.expand(velocity(x) ** 2 + velocity(y) ** 2))


def equations(path=None):
    return from_lagrangian(
        kinetic(m1, x1, y1) + kinetic(m2, x2, y2) - m1 * g * y1 - m2 * g * y2,
        coordinates=[angle1, angle2],
        velocities=[rate1, rate2],
        parameters=[m1, m2, l1, l2, g],
        functions={"height": y2},
        title="Equations of the double pendulum; the angles are counted from the downward vertical",
        path=path,
    )


if __name__ == "__main__":
    equations(Path(__file__).with_name("double_pendulum") / "equations.py")
