"""Odd and hostile scenes and points: each gives a result or one line, without any other exception or warning.

More of them: python scripts/tools/fuzz_scenes.py --count N --seed S.
"""

import logging
import os
from random import Random

import odd_scenes
import pytest

# Times the number of cases; the default takes well under a minute.
EFFORT = float(os.environ.get("ATLAS_FUZZ_EFFORT", "1"))


@pytest.fixture(scope="module", params=[0.2, pytest.param(1.0, marks=pytest.mark.long)])
def cases(request):
    """Function of a kind and a number: generators of so many cases, of which the usual tests take a fifth."""

    def cases(kind: str, count: int) -> list[Random]:
        return [Random(f"{kind} 0 {case}") for case in range(round(request.param * EFFORT * count))]

    return cases


@pytest.fixture(autouse=True, scope="module")
def interpreted():
    """Kernels that are not compiled, made once for all tests."""
    with pytest.MonkeyPatch.context() as patched:
        odd_scenes.use_interpreted_kernels(patched)
        logging.disable()
        yield
        logging.disable(logging.NOTSET)


def test_odd_scenes_are_read_and_checked_or_refused_in_one_line(cases):
    outcomes = [odd_scenes.try_scene(odd_scenes.scene_text(rng)) for rng in cases("check", 1500)]
    accepted = outcomes.count("ok")
    assert 0.1 * len(outcomes) < accepted < 0.9 * len(outcomes)
    assert len(set(outcomes)) > 100  # the grammar reaches many different complaints


@pytest.mark.long
def test_odd_scenes_run_or_are_refused_in_one_line(cases):
    outcomes = [odd_scenes.try_run(odd_scenes.scene_text(rng)) for rng in cases("run", 60)]
    assert outcomes.count("ok") > 0.1 * len(outcomes)


@pytest.mark.long
def test_odd_points_are_labelled_or_refused_in_one_line(cases):
    outcomes = [odd_scenes.try_points(rng) for rng in cases("points", 50)]
    assert outcomes.count("ok") > 0.1 * len(outcomes)


def test_odd_tables_and_ties_have_the_values_of_their_text_or_are_refused_in_one_line(cases):
    for attempt, count in ((odd_scenes.try_csv, 800), (odd_scenes.try_tie, 800)):
        outcomes = [attempt(rng) for rng in cases(attempt.__name__, count)]
        assert 0.1 * len(outcomes) < outcomes.count("ok") < 0.9 * len(outcomes)
