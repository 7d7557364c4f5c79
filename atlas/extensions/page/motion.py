"""Equations, start values, constants and steps by which a page integrates the points of an atlas."""

from __future__ import annotations

import ast
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr

from ...analysis.metadata import axes_of, settings_of
from ...errors import BadInput
from ...kernel import assemble
from ...kernel.augmented import with_frame_vector
from ...kernel.differentiate import simplify
from ...kernel.ensemble import Ensemble
from ...kernel.stepsize import StepSizes, steps_between_instants
from ...kernel.tableaux import METHODS
from ...label.trajectory import frame_vector
from ...scene import grid
from ...scene.model import Duration, Scene
from ...systems import arithmetic
from ...systems.base import Array, System

SAMPLES = 1001  # number of instants of a motion, the default of atlas.trajectory
# Functions in `_KERNEL` integrate a motion, in the kernel's units. Functions in `_OF_BODY` show a body, in the caller's units, and
# may be absent.
_KERNEL = ("rhs", "scaled", "unscaled")
_OF_BODY = ("frame_motion", "axis_in_frame")


@dataclass(frozen=True)
class Motions:
    """Start values of the points of an atlas, as arrays (..., *points)."""

    parameters: dict[str, Array]  # parameter -> value at the start, nan where it is not given
    # `state` and `constants` are as in `Ensemble`. If a body's equations lack `axis_in_frame`, `state` ends with the frame's first axis.
    state: Array
    constants: Array
    duration: Array  # length of the run in time units
    steps: np.ndarray  # number of steps from one instant of the trajectory to the next
    reason: np.ndarray  # index in `sentences` of the reason why a point has no motion, else 0
    sentences: list[str]
    method: str  # a key of `tableaux.METHODS`


def sources(system: System, method: str) -> dict[str, str]:
    """Return the Python functions that integrate a point and show its motion, as name -> source. States are as in `Motions`."""
    equations = with_frame_vector(system.equations)
    texts = arithmetic.functions(equations)
    observables = [observable.name for observable in system.observables]
    result = {name: texts[name] for name in (*_KERNEL, *_OF_BODY, *observables) if name in texts}
    queue = list(result.values())
    while queue:
        for name in arithmetic.names_in(queue.pop()):
            if name in texts and name not in result:
                result[name] = texts[name]
                queue.append(texts[name])
    for name in ("rhs", "unscaled"):
        result[name] = simplify(result[name], (), {}, equations.ONES)
    lines = assemble.step_lines(METHODS[method])
    result["step"] = "\n    ".join(["def step(state, slope, constants):", *lines])
    return result


def motions(ds: xr.Dataset, system: System, scene: Scene | None, dims: list[str]) -> Motions:
    """Return the starts of all points, as `ds.atlas.trajectory` integrates them. Raise BadInput if a value is missing."""
    sizes = {dim: ds.sizes[dim] for dim in dims}

    def column(name: str) -> Array:
        """Return the values of a variable at every point, in C order of the dimensions of the points."""
        return over_points(ds[name], sizes).astype(np.float64).ravel()

    if scene is None:
        if "end_time" not in ds:
            raise BadInput("end_time: not in this dataset; a trajectory needs it to end where the point did")
        parameters = {}
        for name, parameter in system.parameters.items():
            if name in ds.coords:
                parameters[name] = column(name)
            elif math.isnan(parameter.default):
                parameters[name] = np.full(math.prod(sizes.values()), math.nan)
            else:
                raise BadInput(f"{name}: this parameter of the points is not in the dataset")
        duration, settings = column("end_time"), settings_of(ds)
        rate_tolerance = grid.at_points(system, settings.rate_tolerance, parameters)
        reason, family, unit = grid.reasons(system, parameters), None, Duration()
    else:
        located = grid.points_at(scene, {axis.name: column(dim) for dim, axis in axes_of(scene).items()})
        parameters, duration, settings = located.points, located.until, scene.settings
        reason, rate_tolerance = located.reason, located.rate_tolerance
        family, unit = scene.family, scene.duration
    sentences = [grid.sentence(each, system, family, unit) if each else "" for each in grid.Reason]
    ensemble = Ensemble.of(system, parameters)
    state = ensemble.state
    if with_frame_vector(system.equations) is not system.equations:
        state = np.concatenate([state, frame_vector(system, parameters, state, ensemble.constants)])
    with np.errstate(all="ignore"):
        finite = np.where(np.isfinite(duration), duration, 0.0)
        at_points = settings.at(rate_tolerance)
        count = StepSizes.of(at_points, ensemble.frequency_bound, finite).steps
        if system.has_numeric_bound:  # the frequency bound would need runs, so the atlas gives the steps
            if "step" not in ds:
                raise BadInput(
                    "step: not in this dataset; the frequency bound of this system is numeric, and its steps are those"
                    " recorded"
                )
            recorded = np.rint(duration / column("step"))
            valid = np.isfinite(recorded) & (recorded >= 1)
            count = np.where(valid, recorded, count).astype(np.int64)
    steps = steps_between_instants(at_points, count, finite, SAMPLES - 1)

    def shaped(values: np.ndarray) -> np.ndarray:
        """Split the last axis of an array, the points, into the dimensions of the points."""
        return values.reshape(*values.shape[:-1], *sizes.values())

    return Motions(
        {name: shaped(values) for name, values in parameters.items()},
        shaped(state), shaped(ensemble.constants), shaped(duration), shaped(steps), shaped(reason), sentences,
        settings.method,
    )  # fmt: skip


def over_points(array: xr.DataArray, sizes: Mapping[str, int]) -> np.ndarray:
    """Broadcast an array with some dimensions of the points to all dimensions. `sizes` maps dimensions, in order, to sizes."""
    whole = array.expand_dims({dim: size for dim, size in sizes.items() if dim not in array.dims})
    return np.asarray(whole.transpose(*sizes).values)


_OPERATORS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}
MAX_POWER = 64
_AXPY = """function axpy$(y, weights, slopes) {
  const result = new Array(y.length);
  for (let i = 0; i < y.length; i++) {
    let sum = weights[0] * slopes[0][i];
    for (let j = 1; j < weights.length; j++) sum += weights[j] * slopes[j][i];
    result[i] = y[i] + sum;
  }
  return result;
}"""


class CannotTranslate(ValueError):
    """Exception for an expression or statement that has no translation. The message quotes the expression or statement."""


def translate(sources: Mapping[str, str]) -> str:
    """Translate Python functions in the grammar of `arithmetic` to JavaScript, or raise CannotTranslate.

    Tuples (arrays in JavaScript), calls of `axpy` and calls between these functions are allowed too. Every name gets the ending "$",
    which neither Python names nor words of JavaScript have.
    """
    functions = frozenset((*sources, "axpy"))
    scripts = [_Function(name, text, functions).script() for name, text in sources.items()]
    return "\n".join([_AXPY, *scripts])


def _number(value: float) -> str:
    """Return JavaScript source of a number with the same 64 bits as `value`."""
    return {"inf": "Infinity", "nan": "NaN"}.get(repr(float(value)), repr(float(value)))


class _Function:
    """Translation of one function."""

    def __init__(self, name: str, text: str, functions: frozenset[str]):
        try:
            (self.node,) = ast.parse(text).body
        except SyntaxError as error:
            raise CannotTranslate(f"{name}: {error.msg}") from None
        self.name, self.functions = name, functions
        self.temporaries = 0
        self.parameters: list[str] = []
        self.locals: dict[str, None] = {}  # in the order of the first assignment

    def script(self) -> str:
        """Return the function in JavaScript."""
        node = self.node
        if not isinstance(node, ast.FunctionDef):
            raise self.fault(node)
        arguments = node.args
        if arguments.vararg or arguments.kwarg or arguments.kwonlyargs or arguments.defaults:
            raise CannotTranslate(f"{self.name}: parameters other than positional ones")
        self.parameters = [argument.arg for argument in (*arguments.posonlyargs, *arguments.args)]
        body = [line for statement in node.body for line in self.statement(statement)]
        names = [f"{name}$" for name in self.locals if name not in self.parameters]
        names += [f"t${i}" for i in range(self.temporaries)]
        head = f"function {self.name}$({', '.join(f'{name}$' for name in self.parameters)}) {{"
        lines = [f"let {', '.join(names)};", *body] if names else body
        return "\n".join([head, *(f"  {line}" for line in lines), "}"])

    def fault(self, node: ast.AST) -> CannotTranslate:
        """Return the exception for a node without translation."""
        text = ast.unparse(node).partition("\n")[0]
        return CannotTranslate(f"{self.name}: {text}")

    def statement(self, node: ast.stmt) -> list[str]:
        """Return the lines of JavaScript for one Python statement."""
        match node:
            case ast.Return(value=ast.expr() as value):
                return [f"return {self.expression(value)};"]
            case ast.Assign(targets=[target], value=value):
                return self.assignment(target, value)
        raise self.fault(node)

    def assignment(self, target: ast.expr, value: ast.expr) -> list[str]:
        """Return lines that assign a value to a name, or the items of a tuple to several names."""
        if isinstance(target, ast.Name):
            return self.assigned(target, self.expression(value))
        if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
            if len(value.elts) != len(target.elts):
                raise self.fault(value)
            items = [self.temporary() for _ in target.elts]
            lines = [
                f"{item} = {self.expression(each)};" for item, each in zip(items, value.elts, strict=True)
            ]
            for each, item in zip(target.elts, items, strict=True):
                lines += self.assigned(each, item)
            return lines
        whole = self.temporary()
        return [f"{whole} = {self.expression(value)};", *self.assigned(target, whole)]

    def assigned(self, target: ast.expr, text: str) -> list[str]:
        """Return lines of JavaScript that assign the expression `text` to a name, or the expression's items to a tuple of names."""
        if isinstance(target, ast.Name):
            self.locals[target.id] = None
            return [f"{target.id}$ = {text};"]
        if isinstance(target, ast.Tuple):
            items = enumerate(target.elts)
            return [line for i, each in items for line in self.assigned(each, f"{text}[{i}]")]
        raise self.fault(target)

    def temporary(self) -> str:
        """Return a new name, different from all Python names."""
        self.temporaries += 1
        return f"t${self.temporaries - 1}"

    def expression(self, node: ast.expr) -> str:
        """Translate an expression. The text is in parentheses unless it is one name, number or call."""
        match node:
            case ast.Constant(value=int() | float() as value):
                return _number(value)
            case ast.Name(id=name) if name in self.locals or name in self.parameters:
                return f"{name}$"
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return f"(-{self.expression(operand)})"
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return self.expression(operand)
            case ast.BinOp(left=base, op=ast.Pow(), right=exponent):
                return self.power(base, exponent)
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
                return f"({self.expression(left)} {_OPERATORS[type(op)]} {self.expression(right)})"
            case ast.Tuple(elts=elements):
                return f"[{', '.join(map(self.expression, elements))}]"
            case ast.Call(func=ast.Name(id=name) as function, args=arguments, keywords=[]):
                if name not in self.functions and name not in arithmetic.FUNCTIONS:
                    raise self.fault(function)
                translated = f"{name}$" if name in self.functions else f"Math.{name}"
                return f"{translated}({', '.join(map(self.expression, arguments))})"
        raise self.fault(node)

    def power(self, base: ast.expr, exponent: ast.expr) -> str:
        """Translate a power to a product, a square root, or a call of Math.pow, which may differ from Python in the last bit."""
        sign = 1.0
        if isinstance(exponent, ast.UnaryOp) and isinstance(exponent.op, ast.USub):
            sign, exponent = -1.0, exponent.operand
        if not isinstance(exponent, ast.Constant) or not isinstance(exponent.value, int | float):
            if sign < 0:
                exponent = ast.UnaryOp(ast.USub(), exponent)
            return f"Math.pow({self.expression(base)}, {self.expression(exponent)})"
        number = sign * exponent.value
        text = self.expression(base)
        if number == 0.5:
            return f"Math.sqrt({text})"
        if number != int(number) or not 1 <= abs(number) <= MAX_POWER:
            return f"Math.pow({text}, {_number(number)})"
        product = self.product(base, text, int(abs(number)))
        return product if number > 0 else f"(1.0 / {product})"

    def product(self, base: ast.expr, text: str, count: int) -> str:
        """Translate a power with the integer exponent `count` into a product, by repeated squaring."""
        if count == 1:
            return text
        if not isinstance(base, ast.Name | ast.Constant):
            return f"((x) => {self.product(ast.Name('x'), 'x', count)})({text})"
        factors, square = [], text
        while count:
            if count & 1:
                factors.append(square)
            square, count = f"({square} * {square})", count >> 1
        result = factors[0]
        for factor in factors[1:]:
            result = f"({result} * {factor})"
        return result
