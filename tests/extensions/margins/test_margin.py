"""The distance of points from a change of label along an axis, against brute force and closed forms."""

import numpy as np
import pytest

import atlas
from atlas import BadInput
from atlas.extensions.margins.margin import Source
from atlas.flags import Label

pytestmark = pytest.mark.usefixtures("whole_kernels")


def is_stable(P, Q):
    """Whether no root of lambda^4 + P lambda^2 + Q = 0 grows."""
    return P > 0 and Q > 0 and P**2 > 4 * Q


def cylindrical(sigma, m):
    """A symmetric satellite turning about the normal, A = Omega = 1."""
    second = sigma * (1 + m) - 1
    first = second + 3 * (sigma - 1)
    return is_stable(first + second + (1 - second) ** 2, first * second)


def perp_velocity(sigma, theta0):
    """A symmetric satellite tilted towards the radius: its rotor makes (C w3 + k3) / A equal to (4 - 3 sigma) cos theta."""
    c, momentum = np.cos(theta0), (4 - 3 * sigma) * np.cos(theta0)
    tt, pp = np.cos(2 * theta0) * (3 * sigma - 4) + momentum * c, 3 * (1 - sigma)
    return is_stable(tt + pp + (2 * c - momentum) ** 2, tt * pp)


def gravity_gradient(K1, K3):
    """Lagrange's triangle and the region of DeBra and Delp."""
    return K1 * K3 > 0 and K1 > K3 and 4 * np.sqrt(K1 * K3) < 1 + 3 * K1 + K1 * K3


def sleeping_top(r0, l3):
    """An upright top, A = 1: (C r + l)^2 > 4 (Mg z0 - N (A - C))."""
    return (0.4 * r0 + l3) ** 2 > 4 * (1 - 0.3 * 0.6)


def conical(l3, n):
    """A heavy top in the field N, whose axis is free or on a regular precession, not on the vertical, and does not nutate away."""
    c = ((0.2 + l3) * n + 0.3) / (0.6 * (n**2 - 2))
    nutation = (n**2 - 1.2) * (1 - c**2) + (0.4 * (0.5 + n * c) + l3 - 2 * n * c) ** 2
    return abs(c) < 1 and nutation > 0


SCENES = {
    "stability_cylindrical": ({"sigma": 9, "m": 31}, "m", cylindrical),
    "stability_perp_velocity": ({"sigma": 9, "theta0": 23}, "theta0", perp_velocity),
    "gravity_gradient": ({"K1": 24, "K3": 10}, "K1", gravity_gradient),
    "sleeping_top_spin": ({"r0": 25, "l3": 8}, "r0", sleeping_top),
    "quickstart": ({"l3": 10, "n": 24}, "n", conical),
}


@pytest.fixture(scope="module")
def run():
    """An example scene on a coarse grid, run once."""
    known = {}

    def of(name):
        if name not in known:
            axes = {axis: {"count": count} for axis, count in SCENES[name][0].items()}
            known[name] = atlas.run(atlas.example(name, axes=axes), progress=False)
        return known[name]

    return of


def next_change(flags, i, step):
    """Indices of the two neighbours between which a flag of a row changes first, going from one of them; None without a change."""
    j = i
    while 0 <= j + step < len(flags):
        if flags[j + step] != flags[i]:
            return sorted((j, j + step))
        j += step
    return None


@pytest.mark.usual("sleeping_top_spin")
@pytest.mark.parametrize("name", SCENES)
def test_margins_are_those_of_brute_force_and_closed_forms(name, run):
    """Every point walks along its row; places from curves change the stability of the closed form, in every row."""
    (_, axis, stable), ds = SCENES[name], run(name)
    (other,) = [dim for dim in ds.label.dims if dim != axis]
    result, v = ds.atlas.margin(axis), ds[axis].values
    assert result.margin.dims == ds.label.dims
    curves = 0
    for row in range(ds.sizes[other]):
        part, at = result.isel({other: row}), float(ds[other][row])
        flags = ds.label.isel({other: row}).values
        for i, value in enumerate(v):
            for side, step in (("down", -1), ("up", 1)):
                distance, source = float(part[side][i]), int(part[f"source_{side}"][i])
                if flags[i] == Label.NOT_COMPUTED:
                    assert np.isnan(distance)
                    continue
                pair = next_change(flags, i, step)
                if pair is None:
                    assert (distance, source) == (np.inf, Source.NOTHING)
                    continue
                low, high = v[pair]
                place = value + step * distance
                if source == Source.CELLS:
                    assert place == pytest.approx((low + high) / 2, abs=1e-12)
                    continue
                assert source == Source.CURVE
                assert low < place < high
                values = {other: at, axis: place}
                sides = [stable(**values | {axis: place + shift}) for shift in (-1e-6, 1e-6)]
                assert sides[0] != sides[1] or (name == "quickstart" and abs(place) < 1e-6)  # no precession
                curves += 1
        least = np.minimum(part.down, part.up)
        np.testing.assert_array_equal(part.margin, least)
        nearer = np.where(part.down <= part.up, part.source_down, part.source_up)
        np.testing.assert_array_equal(part.source_margin, np.where(np.isnan(least), 0, nearer))
    assert curves > 40
    assert ds.atlas.margin(axis).atlas.map("margin").axes


@pytest.mark.long
def test_the_margin_of_given_values_is_that_from_the_value_itself(run):
    """Not from the nearest point: the place stays, from both sides of it."""
    ds = run("stability_perp_velocity").transpose("theta0", "sigma").isel(theta0=slice(None, None, -1))
    grid = ds.atlas.margin("theta0")
    sigma = float(ds.sigma[(grid.source_up == Source.CURVE).any("theta0")][0])
    np.testing.assert_array_equal(grid.theta0, ds.theta0)
    row = grid.sel(sigma=sigma)
    place = float((row.theta0 + row.up).min())
    for value in (place - 0.01, place + 0.01):
        one = ds.atlas.margin("theta0", sigma=sigma, theta0=value)
        assert one.theta0 == value
        assert one.margin == pytest.approx(0.01, abs=1e-8)
        assert one.source_margin == Source.CURVE
        deg = ds.atlas.margin("theta0", sigma=sigma, theta0=np.degrees(value), degrees=True)
        assert deg.margin == pytest.approx(np.degrees(0.01), abs=1e-6)
        assert deg.margin.units == "degree"
        assert "k3" not in one.coords  # of the nearest point, not of this one
    assert ds.atlas.margin("theta0", "predicted", sigma=sigma, theta0=place + 0.01).down == pytest.approx(
        0.01, abs=1e-8
    )
    assert ds.atlas.margin("theta0", "status", sigma=sigma, theta0=place).margin == np.inf


def test_without_theory_places_lie_halfway_on_a_logarithmic_axis_in_the_logarithm():
    """A body at rest without forces, pushed: it drifts once its rate passes the tolerance."""
    scene = {
        "schema": 1,
        "system": "fixed_point",
        "fixed": {"theta0": 1.0},
        "labels": {"rate_tolerance": 1e-3},
    }
    rates = {"from": 1e-5, "to": 0.1, "count": 7, "spacing": "log"}
    scene["axes"] = {"theta_dot0": rates, "phi0": {"values": [0.1, 0.2]}}
    ds = atlas.run(scene | {"integration": {"duration": 1000.0}}, progress=False)
    flags = ds.label.values[:, 0]
    (i,) = np.flatnonzero(np.diff(flags))
    result, rate = ds.atlas.margin("theta_dot0").isel(phi0=0), ds.theta_dot0
    place = np.sqrt(float(rate[i] * rate[i + 1]))
    np.testing.assert_allclose(result.margin, np.abs(place - rate), rtol=1e-12)
    assert (result.source_margin == Source.CELLS).all()


def test_what_has_no_margin_is_refused_in_one_line(run):
    ds = run("quickstart")
    with pytest.raises(BadInput, match=r"axis = 'm': no axis with neighbouring points; allowed: l3, n"):
        ds.atlas.margin("m")
    with pytest.raises(BadInput, match="theta_max: not a flag variable of this atlas"):
        ds.atlas.margin("n", "theta_max")
    with pytest.raises(BadInput, match="n = 9: outside the atlas"):
        ds.atlas.margin("n", l3=0.0, n=9.0)
