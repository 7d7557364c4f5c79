"""Stress cases of motions in the plane: no label that is not true, no statistic beyond its estimate."""

import numpy as np
import pytest

from atlas.extensions.studies import stress
from atlas.extensions.studies.cases import satellite_cases
from atlas.extensions.studies.plane_cases import plane_cases
from atlas.flags import Status
from atlas.systems.base import stress_cases_of
from atlas.systems.satellite import SATELLITE


def study(*names):
    return stress.stress("satellite", [case for case in plane_cases(SATELLITE) if case.name in names])


@pytest.fixture(scope="module")
def pitch():
    return study("pitch")


def test_they_are_among_the_cases_of_the_satellite():
    names = [case.name for case in stress_cases_of(SATELLITE)]
    own = [case.name for case in (*satellite_cases(SATELLITE), *plane_cases(SATELLITE))]
    assert names == own
    assert len(set(names)) == len(names)


def test_no_label_differs_from_the_true_one(pitch):
    assert not stress.mislabelled(pitch).any(), stress.report(pitch)
    assert not stress.unresolved(pitch).any(), stress.report(pitch)
    coarse = pitch.sel(level=["ratio 1.5", "ratio 0.9"])
    unstable = coarse.step_ratio.values > 0.5
    assert unstable.any()
    assert (coarse.verdict.values[unstable] != stress.Verdict.RIGHT).all()


@pytest.mark.long
def test_no_label_where_rounding_decides():
    ds = study("unstable pitch, offset", "unstable pitch, long")
    assert np.unique(ds["case"]).size == 2
    assert not stress.mislabelled(ds).any(), stress.report(ds)


def test_statistics_are_as_accurate_as_the_estimate(pitch):
    known = pitch["statistic_error"].notnull().any("statistic") & (pitch["status"] == Status.OK)
    assert (known.sum([dim for dim in known.dims if dim != "method"]) > 20).all()
    assert not stress.beyond_estimate(pitch).any(), stress.report(pitch)
