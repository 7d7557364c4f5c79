"""Numbers of equilibria as variables: against lists of equilibria, symmetries, and bodies of which they are not certain."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import xarray as xr
from truth import default_points

import atlas
from atlas.extensions.branches import COUNTS
from atlas.systems.base import derived_values, derived_variables
from atlas.systems.fixed_point import FIXED_POINT
from atlas.systems.satellite import SATELLITE

BODY = {"A": 1.0, "B": 1.3, "C": 1.7, "Omega": 1.0}


def counts_of(points, pause=lambda: None):
    """The three numbers at some points, (3, points)."""
    duration = np.ones(np.shape(points["A"]))
    columns = derived_values(SATELLITE, COUNTS, points, duration, pause)
    return np.array([columns[name] for name in COUNTS])


def bodies(count, **columns):
    """Points of bodies: numbers or arrays (count,)."""
    parameters = SATELLITE.parameters.items()
    given = BODY | columns
    return {name: np.broadcast_to(given.get(name, p.default), count) + 0.0 for name, p in parameters}


def random_bodies(count, seed):
    """Bodies of three different moments with rotor and magnet."""
    rng = np.random.default_rng(seed)
    parts = rng.uniform(0.1, 1.0, (3, count))
    columns = dict(zip("ABC", parts.sum(0) - parts, strict=True))
    columns |= {f"{x}{i}": 0.3 * rng.normal(size=count) for x in ("k", "mu") for i in (1, 2, 3)}
    return bodies(count, **columns, h1=rng.normal(size=count), h3=rng.normal(size=count))


def test_numbers_are_those_of_the_list_of_equilibria():
    points = random_bodies(40, 5)
    names = [name for name, parameter in SATELLITE.parameters.items() if not parameter.start]
    ds = atlas.equilibria("satellite", {name: xr.DataArray(points[name], dims="point") for name in names})
    counts = counts_of(points)
    np.testing.assert_array_equal(counts, [ds[name] for name in COUNTS])
    for i in (0, 17, 39):
        one = atlas.equilibria("satellite", {name: points[name][i] for name in names})
        expected = one.sizes["equilibrium"], (one.stable == 1).sum(), (one["index"] == 0).sum()
        np.testing.assert_array_equal(counts[:, i], expected)


def test_images_have_the_same_numbers():
    """Of the symmetries of the equations: signs of two axes, or of all with the momenta, and of the field along the radius."""
    points, images = random_bodies(5, 6), []
    for reverses, signs, a in itertools.product((1, -1), ((1, -1, -1), (-1, 1, 1), (-1, -1, 1)), (1, -1)):
        d = reverses * np.prod(signs)
        changes = {f"k{i}": d * sign for i, sign in enumerate(signs, 1)}
        changes |= {f"mu{i}": sign for i, sign in enumerate(signs, 1)} | {"h1": a, "h3": d}
        images.append({name: points[name] * changes.get(name, 1) for name in points})
    counts = counts_of({name: np.concatenate([image[name] for image in images]) for name in points})
    np.testing.assert_array_equal(counts, np.tile(counts_of(points), len(images)))


def test_energy_stable_equilibria_are_the_minima():
    """Without a rotor the four orientations with the least axis along the radius and the greatest along the normal."""
    assert counts_of(default_points("satellite", A=1.0, B=1.3, C=1.7)).ravel().tolist() == [24, 4, 4]


@pytest.mark.long
def test_bodies_of_which_no_number_is_certain():
    """Two equal moments, three, no orbit, a bifurcation, beside it, an orbit that is too slow."""
    points = bodies(
        6, B=np.array([1.0, 1.0, 1.3, 1.3, 1.3, 1.3]), C=np.array([1.5, 1.0, 1.7, 1.7, 1.7, 1.7]),
        Omega=np.array([1.0, 1.0, 0.0, 1.0, 1.0, 1e-80]), k3=np.array([0.0, 0.0, 0.1, 0.4, 0.4 * (1 + 1e-4), 0.0]),
    )  # fmt: skip
    counts = counts_of(points)
    assert np.isnan(counts).tolist() == 3 * [[True, True, True, True, False, True]]
    listed = SATELLITE.equilibria_of_bodies(points)["index"][4]
    assert counts[:, 4].tolist() == [(listed >= 0).sum(), counts[1, 4], (listed == 0).sum()]


def test_counts_pause_and_stop():
    def stop():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        counts_of(random_bodies(3, 0), stop)


def test_other_systems_have_no_numbers():
    assert not derived_variables(FIXED_POINT).keys() & {*COUNTS}
