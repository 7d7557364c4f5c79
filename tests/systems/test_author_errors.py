"""What authors of systems get wrong: one line each, before anything is compiled."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

import atlas
from atlas import systems
from atlas.systems import Observable, Parameter, System
from atlas.systems.check import is_unit
from atlas.variables import variables


class Equations:
    """A harmonic oscillator."""

    STATE = ("x", "v")
    CONSTANTS = ("omega",)
    INTEGRALS = ("energy",)

    def rhs(state, constants):
        x, v = state
        (omega,) = constants
        return v, -(omega**2) * x

    def energy(state, constants):
        x, v = state
        (omega,) = constants
        return 0.5 * v * v, 0.5 * omega**2 * x * x

    def product(state, constants):
        x, v = state
        return x * v


PARAMETERS = (
    Parameter("omega", "rad s-1", "frequency", 1.0, 0.0),
    Parameter("x0", "m", "place at the start", 1.0, start=True),
)
OBSERVABLES = (Observable("x", "m", "place"), Observable("product", "m2 s-1", "place times velocity"))


class Oscillator(System):
    name = "oscillator"
    title = "harmonic oscillator"
    equations = Equations
    parameters = {parameter.name: parameter for parameter in PARAMETERS}  # noqa: RUF012
    observables = OBSERVABLES

    def initial_state(self, points):
        return np.array([points["x0"], np.zeros_like(points["x0"])])


pytestmark = pytest.mark.usefixtures("own_systems")


def error_of(**members):
    """The message for the oscillator with other members; nothing may have been compiled."""
    kind = type("Changed", (Oscillator,), members)
    with pytest.raises(atlas.BadInput) as caught:
        variables(atlas.register(kind))
    text = str(caught.value)
    assert "\n" not in text
    return text


def equations(**members):
    return type(
        "Equations", (Equations,), {k: v for k, v in vars(Equations).items() if k[0] != "_"} | members
    )


def unknown_name(state, constants):
    x, v = state
    return v, -stiffness * x  # noqa: F821


def two_names(state, constants):
    x, v, w = state
    return v, -x


def another_order(state, constants):
    v, x = state
    return v, -x


def three_components(state, constants):
    x, v = state
    return v, -x, 0.0 * x


def one_component(state, constants):
    x, v = state
    return v


def branches(state, constants):
    x, v = state
    if x > 0:
        v = -v
    return v, -x


def calls(state, constants):
    x, v = state
    return v, -np.sin(x)


def calls_another(state, constants):
    x, v = state
    return v, -erf(x)  # noqa: F821


def comparison(state, constants):
    x, v = state
    return v, -x * (x > 0)


def time_dependent(state, constants, t):
    x, v = state
    return v, -x * t


def no_return(state, constants):
    x, v = state


def a_power(state, constants):
    x, v = state
    return x**v


def a_tuple(state, constants):
    x, v = state
    return x, v


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (
            unknown_name,
            "'return (v, -stiffness * x)': the name 'stiffness' is not defined there; allowed: the state",
        ),
        (two_names, "'x, v, w = state': state has 2 components, and 3 names are assigned"),
        (another_order, "'v, x = state': its order is x, v"),
        (three_components, "rhs: it returns 3 components; allowed: a tuple of 2"),
        (one_component, "rhs: it returns 1 components; allowed: a tuple of 2"),
        (branches, "is not plain arithmetic; allowed: assignments and one return"),
        (calls, "'np.sin' cannot be called; did you mean 'sin'? allowed: sqrt, sin"),
        (calls_another, "'erf' cannot be called"),
        (comparison, "'x > 0' is not plain arithmetic"),
        (time_dependent, "rhs(state, constants, t): allowed: rhs(state, constants)"),
        (no_return, "rhs: it must end with return"),
    ],
)
def test_right_hand_sides(function, message):
    text = error_of(equations=equations(rhs=named(function, "rhs")))
    assert text.startswith("register(Changed): equations: ")
    assert message in text


def named(function, name):
    """The function as if it were defined under another name, for its source as well."""
    import inspect

    source = inspect.getsource(function).replace(f"def {function.__name__}(", f"def {name}(")
    file = f"<{function.__name__} as {name}>"
    import linecache

    linecache.cache[file] = (len(source), None, source.splitlines(True), file)
    namespace = {"np": np}
    exec(compile(source, file, "exec"), namespace)
    return namespace[name]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"STATE": ()}, "STATE is missing"),
        ({"STATE": "xv"}, "STATE = 'xv'; allowed: a tuple of names"),
        ({"STATE": ("x", "x")}, "'x' is named twice in STATE and CONSTANTS"),
        ({"STATE": ("sin", "v")}, "'sin': this name has another meaning in equations"),
        (
            {"CONSTANTS": ("mass",)},
            "the constant mass is no parameter, and the system has no method constants",
        ),
        ({"INTEGRALS": ("momentum",)}, "the function momentum(state, constants) is missing"),
        ({"INTEGRALS": 3}, "INTEGRALS = 3; allowed: a mapping"),
        ({"product": named(a_tuple, "product")}, "product: it returns a tuple of 2; allowed: one number"),
        (
            {"energy": named(one_component, "energy")},
            "energy: it returns one number; allowed: a tuple of terms",
        ),
        ({"scaled": named(time_dependent, "scaled")}, "scaled and unscaled belong together"),
    ],
)
def test_equations(changes, message):
    assert message in error_of(equations=equations(**changes))


def parameters(*more, **changes):
    return {p.name: p for p in (*PARAMETERS, *more)} | changes


@pytest.mark.parametrize(
    ("members", "message"),
    [
        ({"name": "an oscillator"}, "name = 'an oscillator': allowed: at most 60 ASCII letters"),
        ({"name": "satellite"}, "a system of this package has this name; choose another one"),
        ({"title": ""}, "title = '': must be a text"),
        ({"parameters": {}}, "must be a mapping of names to Parameter, not empty"),
        ({"parameters": parameters(k=3)}, "parameters.k = 3: must be a Parameter"),
        ({"parameters": parameters(k=PARAMETERS[0])}, "parameters.k has the name 'omega': both must be the same"),
        ({"parameters": parameters(Parameter("lambda", "1", "x"))}, "parameters.lambda: 'lambda' has another meaning"),
        ({"parameters": parameters(Parameter("abs", "1", "x"))}, "'abs' has another meaning in expressions"),
        ({"parameters": parameters(Parameter("k x", "1", "x"))}, "'k x' cannot be a name"),
        ({"parameters": parameters(Parameter("k", "furlong", "x"))}, "parameters.k: 'furlong' is no unit; allowed: such as"),
        ({"parameters": parameters(Parameter("k", "", "x"))}, "parameters.k: '' is no unit"),
        ({"parameters": parameters(Parameter("k", "1", ""))}, "parameters.k.meaning = '': must be a text"),
        ({"parameters": parameters(Parameter("k", "1", "x", 2.0, 0.0, 1.0))}, "the default 2 is outside its range"),
        ({"parameters": parameters(Parameter("k", "1", "x", 0.0, 0.0, open_low=True))}, "allowed: above 0, at most inf"),
        ({"parameters": parameters(Parameter("k", "1", "x", 0.0, 1.0, -1.0))}, "must be numbers, low below high"),
        ({"parameters": parameters(Parameter("step", "1", "x"))}, "parameter step has the name of a variable of the atlas"),
        ({"observables": ()}, "the function frame_motion(state, constants) is missing (or the system needs observables)"),
        ({"observables": (OBSERVABLES[0], "x")}, "must be a tuple of Observable"),
        ({"observables": (OBSERVABLES[0],) * 2}, "observables: x is named twice"),
        ({"observables": (Observable("area", "m2", "area"),)}, "the function area(state, constants) is missing"),
        ({"observables": (Observable("omega", "m2", "area"),)}, "a parameter has this name"),
        ({"observables": (Observable("x", "metres per second", "x"),)}, "'metres per second' is no unit"),
        ({"observables": (Observable("x", "m", "x", tolerance=0),)}, "tolerance = 0: must be a number above 0"),
        ({"observables": (Observable("x", "m", "x", tolerance=np.inf),)}, "one at least must decide the label"),
        ({"families": {"a": 1}}, "families: only for systems with frame_motion"),
        ({"initial_state": lambda self, points: points["x9"]}, "initial_state fails at the defaults of the parameters: KeyError: 'x9'"),
        ({"initial_state": lambda self, points: points["x0"]}, "initial_state has the shape (2,) for 2 points; allowed: (2, 2)"),
        ({"constants": lambda self, points: np.ones((3, 2))}, "constants has the shape (4, 2) for 2 points; allowed: (2, 2)"),
        ({"frequency_bound": lambda self, points: 1.0}, "frequency_bound has the shape () for 2 points; allowed: (2,)"),
    ],
)  # fmt: skip
def test_members(members, message):
    assert message in error_of(**members)
    assert not any(name.startswith("atlas_kernel") and "oscillator" in name for name in sys.modules)


@pytest.mark.parametrize(
    "name", ["label", "status", "step", "integral_drift", "predicted", "computed", "time", "theta_min"]
)
def test_observables_with_the_name_of_a_variable(name):
    text = error_of(
        equations=equations(**{name: named(one_component, name)}),
        observables=(Observable(name, "1", "a quantity"),),
    )
    assert text == (
        f"the system oscillator: its observable {name} has the name of a variable of the atlas; choose another name"
    )


def test_an_observable_with_the_name_of_a_statistic_of_another():
    observables = (Observable("x", "m", "place"), Observable("x_mean", "m", "another"))
    text = error_of(equations=equations(x_mean=named(one_component, "x_mean")), observables=observables)
    assert "its observable x_mean has the name of a variable of the atlas" in text


def test_powers_that_cannot_be_differentiated():
    changed = equations(power=named(a_power, "power"))
    kind = type(
        "Powers", (Oscillator,), {"equations": changed, "observables": (Observable("power", "1", "x^v"),)}
    )
    atlas.register(kind)
    with pytest.raises(atlas.BadInput, match=r"equations: cannot be differentiated: x \*\* v"):
        atlas.label_points("oscillator", {"x0": 1.0})


def test_things_that_are_no_systems():
    for thing in (None, 3, "satellite", SimpleNamespace(name="x"), dict):
        with pytest.raises(atlas.BadInput, match=r"not an object of a subclass of atlas\.systems\.System"):
            atlas.register(thing)


def test_a_system_with_all_that_is_required_is_registered():
    system = atlas.register(Oscillator())
    assert systems.get("oscillator") is system
    state = np.array([[1.0], [2.0]])
    np.testing.assert_allclose(system.equations.rhs(state, np.array([[3.0], [1.0]])), [[2.0], [-9.0]])
    assert system.equations.CONSTANTS == ("omega", "time_unit")
    scaled = system.equations.scaled(state, np.array([[3.0], [1.0]]), 0.5)
    np.testing.assert_allclose(system.equations.rhs(*scaled), [[1.0], [-4.5]])


@pytest.mark.parametrize("unit", ["1", "m", "kg m2", "rad s-1", "kg m2 s-1", "m/s", "m s^-2", "km", "mW", "degrees", "1e3 m", "kg*m**2"])  # fmt: skip
def test_units(unit):
    assert is_unit(unit)


@pytest.mark.parametrize("text", ["", " ", "foo", "m s-1 ", "metres per second", "m^", "m^x", "-", "(m)", "kg m2 furlong", None, 1, "m;rm"])  # fmt: skip
def test_texts_that_are_no_units(text):
    assert not is_unit(text)
