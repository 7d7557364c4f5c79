"""The kernel of nodes against the kernel with statistics and the equations."""

from __future__ import annotations

import numpy as np
import pytest

from atlas import systems
from atlas.kernel import specialization
from atlas.kernel.ensemble import Ensemble
from atlas.scene.tables import point_columns

BODIES = {
    "satellite": {"A": 1.0, "B": 1.1, "C": np.linspace(1.2, 1.5, 35), "theta0": 0.4, "n": 0.3, "k3": 0.1, "h1": 0.2, "mu3": 0.3},
    "fixed_point": {"A": 1.0, "B": 1.1, "C": np.linspace(1.2, 1.5, 35), "theta0": 0.4, "n": 2.0, "Mg": 3.0, "z0": 0.4},
}  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "method"), [("satellite", "rk8"), ("fixed_point", "rk8"), ("fixed_point", "rk4")]
)
def test_nodes_are_states_of_the_kernel_with_statistics(name, method):
    """More points than a block has, with other numbers of steps between nodes and other steps; the start is node 0."""
    system = systems.get(name)
    columns, size = point_columns(system, BODIES[name])
    ensemble, steps = Ensemble.of(system, columns), np.arange(size) % 3 + 1
    step_size, count = np.linspace(0.05, 0.1, size), 12
    kernel = specialization.kernel(system, method)
    expected = ensemble.states_at_samples(kernel, steps, np.broadcast_to(step_size, (count - 1, size)))
    states, slopes = ensemble.nodes(specialization.node_kernel(system, method), steps, step_size, count)
    assert np.abs(states[:, 0] - ensemble.state).max() < 1e-15
    assert np.abs(states[:, 1:] - expected).max() < 1e-13
    assert np.abs(slopes - system.equations.rhs(states, ensemble.constants[:, None])).max() < 1e-13
