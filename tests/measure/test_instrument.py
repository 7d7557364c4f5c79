"""Rules: what rounding decides, and what errors of measurements may change; by numbers, with a rule of two statistics."""

import numpy as np
import pytest

from atlas.measure.instrument import Rule, Tolerances, Variable, could_change

DRIFT = 1.5  # rate added to the mean
NAMES = ("mean", "spread", "theta_min")


def label(measured):
    """1 where |mean + DRIFT| > 1, 2 more where spread > 0.5, 4 more where theta_min < 0.2."""
    fast = np.abs(measured["mean"] + DRIFT) > 1.0
    return fast * 1 + (measured["spread"] > 0.5) * 2 + (measured["theta_min"] < 0.2) * 4


def of(mean, spread=0.0, theta_min=1.0):
    return {"mean": np.array([mean]), "spread": np.array([spread]), "theta_min": np.array([theta_min])}


RULE = Rule(label, NAMES, {"mean": DRIFT})


@pytest.mark.parametrize(
    ("measured", "error", "expected"),
    [
        (of(0.0), of(0.4, 0.0, 0.0), False),
        (of(0.0), of(0.6, 0.0, 0.0), True),  # 1.5 - 0.6 < 1
        (of(-3.2), of(0.6, 0.0, 0.0), False),  # -1.7 shrinks to -1.1
        (of(-3.2), of(0.8, 0.0, 0.0), True),
        (of(-2.2), of(0.2, 0.0, 0.0), False),  # -0.7 grows to -0.9
        (of(-2.2), of(0.4, 0.0, 0.0), True),
        (of(-1.6), of(0.5, 0.0, 0.0), False),  # -0.1 does not get through 0
        (of(0.0, 0.4), of(0.0, 0.05, 0.0), False),
        (of(0.0, 0.4), of(0.0, 0.15, 0.0), True),
        (of(0.0, 0.6), of(0.0, 0.15, 0.0), True),
        (of(0.0, 0.0, 0.3), of(0.0, 0.0, 0.05), False),
        (of(0.0, 0.0, 0.3), of(0.0, 0.0, 0.15), True),
        # The least theta falls where all else grows: together they change nothing here.
        (of(0.0, 0.0, 0.15), of(0.0, 0.0, 0.1), True),
        (of(0.0, 0.0, 0.15), of(0.0, 0.0, 0.01), False),
    ],
)
def test_errors_that_could_change_a_label(measured, error, expected):
    assert could_change(RULE, measured, error).tolist() == [expected]
    others = error | {"other": np.array([9.0])}
    assert could_change(RULE, measured, others).tolist() == [expected]
    # Statistics that the rule does not read have no say.
    none = Rule(label, (), {"mean": DRIFT})
    assert not could_change(none, measured, error).any()


def test_all_measurements_grow_or_fall_together():
    """Means by their magnitude, and theta against them: of a sum, or of a difference with theta, 0.1 and 0.2 are 0.3."""

    def of_sum(measured):
        return np.abs(measured["mean"] + DRIFT) + measured["spread"] - measured["theta_min"] > 2.0

    rule, error = Rule(of_sum, NAMES, {"mean": DRIFT}), of(0.1, 0.1, 0.1)
    for mean in (0.0, -2 * DRIFT):
        assert could_change(rule, of(mean, 0.75, 0.5), error).tolist() == [True]  # 1.75 + 0.3
        assert could_change(rule, of(mean, 0.65, 0.5), error).tolist() == [False]
        assert could_change(rule, of(mean, 1.25, 0.5), error).tolist() == [True]  # 2.25 - 0.3
        assert could_change(rule, of(mean, 1.35, 0.5), error).tolist() == [False]


def test_measurements_that_may_be_rounding_count_as_none():
    rule = Rule(label, NAMES, {"mean": DRIFT}, {"mean": np.array([0.1]), "spread": np.array([0.7])})
    measured = of(-1.45, 0.6)
    assert label(measured) == [2]
    decisive = rule.without_rounding(measured)
    assert (decisive["mean"], decisive["spread"], decisive["theta_min"]) == (-DRIFT, 0.0, 1.0)
    assert rule.decide(measured) == [0]
    assert rule.decide(of(-1.45, 0.8)) == [2]  # more than rounding
    assert rule.without_rounding(of(-1.39, 0.8))["mean"] == -1.39
    exact = of(-DRIFT, 0.0)
    assert rule.without_rounding(exact) is exact
    assert RULE.without_rounding(measured) is measured
    both = {name: np.r_[value, value] for name, value in measured.items()}
    both["spread"] = np.array([0.6, 0.9])
    each = Rule(label, NAMES, {"mean": DRIFT}, {"spread": np.array([0.7, 0.7])})
    assert each.decide(both).tolist() == [0, 2]


def test_tolerances_of_some_points():
    every = Tolerances(np.array([1.0, 2.0, 3.0]), 0.1)
    assert every.subset(np.array([2, 0])).rate.tolist() == [3.0, 1.0]
    one = Tolerances(1.0, 0.1)
    assert one.subset(np.array([0])) is one


def test_attributes_of_a_variable():
    number = Variable("x", "float64", "rad", "an angle", comment="of nothing")
    assert number.attributes() == {"long_name": "an angle", "units": "rad", "comment": "of nothing"}
    flag = Variable("y", "int8", "1", "a kind", {"none": "", "one": ""})
    assert flag.attributes()["flag_values"].tolist() == [0, 1]
    assert flag.attributes()["flag_meanings"] == "none one"
    assert "units" not in flag.attributes()
