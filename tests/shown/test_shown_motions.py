"""Pictures, numbers and lists of one motion are those of its dataset, of own projections, and of a closed form."""

import importlib

import numpy as np
import pytest
from plugins import PENDULUM

import atlas

pytestmark = pytest.mark.usefixtures("whole_kernels")


def test_observables_of_another_system_have_their_names_and_units(tmp_path, monkeypatch, own_systems):
    (tmp_path / "pendulum_of_shown.py").write_text(PENDULUM)
    monkeypatch.syspath_prepend(tmp_path)
    atlas.register(importlib.import_module("pendulum_of_shown").Pendulum)
    tr = atlas.trajectory("pendulum", {"omega": 1.2, "x0": 0.8, "cubic": 0.1}, duration=5.0, samples=51)
    for degrees, unit, size in ((False, "rad", 1.0), (True, "deg", 180 / np.pi)):
        x, height = tr.atlas.plot(degrees=degrees).axes
        assert (x.get_ylabel(), height.get_ylabel(), height.get_xlabel()) == (
            f"$x$ ({unit})",
            "height",
            "time (s)",
        )
        np.testing.assert_allclose(x.lines[0].get_ydata(), size * tr.x)
        np.testing.assert_allclose(height.lines[0].get_ydata(), 1 - np.cos(tr.x), atol=1e-12)
