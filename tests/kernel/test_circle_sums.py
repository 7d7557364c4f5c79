"""Sums of circles in kernels: compiled and in Python, and kernels without them."""

import numpy as np
import pytest
from plain_kernel import plain_module
from strategies import RANDOM

from atlas.kernel import blocks
from atlas.kernel.ensemble import Ensemble
from atlas.kernel.specialization import kernel
from atlas.kernel.statistics import Row
from atlas.measure.circle import CIRCLES, Axis, Sum
from atlas.systems import SYSTEMS


@pytest.mark.usual("satellite")
@pytest.mark.parametrize(("name", "method"), [("satellite", "rk4"), ("fixed_point", "rk8")])
def test_the_compiled_kernel_is_the_python_one(name, method):
    """In one call and in several, and with the statistics and states of the kernel that measures no circles."""
    system = SYSTEMS[name]
    frames = 1 if system.frame_rate is None else 2
    points = RANDOM[system.name](np.random.default_rng(7), 20)
    plugs = CIRCLES[:frames]
    ensemble = Ensemble.of(system, points, plugs)
    stride = 1 if method == "rk8" else 2
    schedule = blocks.pack_blocks(np.full(20, 48), np.full(20, stride))

    def run(module, ensemble, lasts=(int(schedule.nodes[0]),)):
        arrays = blocks.resumable(module, ensemble.arrays(module, np.full(20, 2.0 / 48), 1e-5))
        first = np.zeros_like(schedule.nodes)
        for last in lasts:
            segment = first, np.full_like(first, last)
            blocks.integrate(module, schedule, arrays, segment=segment, threads=blocks.Threads(1))
            first = segment[1]
        return arrays.state, arrays.sums

    compiled = kernel(system, method, plugs=plugs)
    plain = plain_module(system.equations, method, plugs=plugs)
    state, sums = run(compiled, ensemble)
    for other in (run(plain, ensemble), run(compiled, ensemble, (5, int(schedule.nodes[0])))):
        np.testing.assert_allclose(other[0], state, rtol=1e-11, atol=1e-12)
        np.testing.assert_allclose(other[1][len(Row) :], sums[len(Row) :], rtol=1e-8, atol=1e-9)
    np.testing.assert_array_equal(other[1], sums)
    state_without, sums_without = run(kernel(system, method), Ensemble.of(system, points))
    np.testing.assert_array_equal(state_without, state)
    np.testing.assert_array_equal(sums_without, sums[: len(Row)])
    assert sums.shape[0] == len(Row) + frames * len(Sum)
    assert ensemble.given.shape[0] == frames * len(Axis)
