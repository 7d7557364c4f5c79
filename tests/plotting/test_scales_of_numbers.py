"""Colours of numbers on maps: their ends, their scale, and what is refused."""

import math

import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import LogNorm, SymLogNorm

import atlas
from atlas import BadInput

X, Y = np.arange(4.0), np.arange(3.0)


def numbers(values, name: str = "theta_dot_rms", units: str = "rad s-1") -> xr.Dataset:
    """A dataset like an atlas without a scene."""
    array = xr.DataArray(np.asarray(values, float).reshape(4, 3), {"x": X, "y": Y}, attrs={"units": units})
    return xr.Dataset({name: array}, attrs={"atlas_system": "satellite"})


def scale(ds: xr.Dataset, **options):
    """Norm, colour map and extension of the colour bar of a map."""
    figure = ds.atlas.map(**options)
    mesh = figure.axes[0].collections[0]
    return mesh.norm, mesh.cmap.name, mesh.colorbar.extend


EXPONENTS = numbers(np.linspace(-1.2, 0.3, 12), "lyapunov", "s-1")


@pytest.mark.parametrize(
    ("options", "ends", "colours", "extend"),
    [
        ({}, (-1.2, 1.2), "cividis", "neither"),
        ({"vmax": 0.3}, (-0.3, 0.3), "cividis", "min"),
        ({"vmin": -0.6}, (-0.6, 0.6), "cividis", "min"),
        ({"vmin": 0}, (0.0, 0.3), "viridis", "min"),
        ({"vmin": -0.1, "vmax": 0.2}, (-0.1, 0.2), "viridis", "both"),
        ({"vmax": -0.2}, (-1.2, -0.2), "viridis", "max"),
        ({"norm": "linear"}, (-1.2, 0.3), "viridis", "neither"),
    ],
)
def test_ends_of_the_colours(options, ends, colours, extend):
    norm, name, extended = scale(EXPONENTS, **options)
    assert (norm.vmin, norm.vmax) == pytest.approx(ends)
    assert (name, extended) == (colours, extend)


def test_exponents_of_one_sign_have_sequential_colours():
    for values in (np.linspace(0.1, 0.28, 12), np.linspace(-1.2, -0.1, 12)):
        norm, name, _ = scale(numbers(values, "lyapunov"))
        assert name == "viridis"
        assert (norm.vmin, norm.vmax) == pytest.approx((values[0], values[-1]))


def test_angles_are_linear_and_in_the_unit_shown():
    angles = numbers(np.geomspace(0.01, math.pi, 12), "theta_max", "rad")
    norm = scale(angles)[0]
    assert not isinstance(norm, LogNorm)
    assert (norm.vmin, norm.vmax) == pytest.approx((0.01, math.pi))
    norm = scale(angles, degrees=True, vmax=90)[0]
    assert not isinstance(norm, LogNorm)
    assert (norm.vmin, norm.vmax) == pytest.approx((math.degrees(0.01), 90))
    assert isinstance(scale(angles, norm="log")[0], LogNorm)
    for name, units in (("first_order_error", "rad"), ("x_drift", "rad"), ("theta_dot_rms", "rad s-1")):
        assert isinstance(
            scale(angles.rename(theta_max=name).map(lambda a, u=units: a.assign_attrs(units=u)))[0], LogNorm
        )


def test_scales_by_name_and_of_matplotlib():
    values = numbers([0.0, *np.geomspace(1e-3, 10, 11)])
    norm, _, extend = scale(values, norm="log", vmin=0.1, vmax=1)
    assert isinstance(norm, LogNorm)
    assert (norm.vmin, norm.vmax, extend) == (0.1, 1, "both")
    norm = scale(values, norm="linear", vmax=5)[0]
    assert (type(norm)(0, 5)(2.5), norm.vmin, norm.vmax) == (0.5, 0, 5)
    assert scale(values, norm="symlog")[0](0.0) == 0
    own = SymLogNorm(0.01)
    drawn, _, _ = scale(values, norm=own)
    assert isinstance(drawn, SymLogNorm)
    assert (drawn.linthresh, drawn.vmin, drawn.vmax) == (0.01, 0, 10)
    assert own.vmin is None  # the caller's is left alone
    assert scale(numbers(range(12)), vmax=5.5)[0].vmax == 5.5  # integers


def test_over_one_axis_they_are_those_of_the_vertical_axis():
    values = numbers(np.geomspace(1e-3, 10, 12))
    ax = values.atlas.map(select={"y": 1.0}, norm="linear", vmin=0.5).axes[0]
    assert (ax.get_yscale(), ax.get_ylim()[0]) == ("linear", 0.5)
    assert values.atlas.map(select={"y": 1.0}, norm="log", vmax=3).axes[0].get_ylim()[1] == 3


FLAGS = numbers(np.ones(12)).assign(
    label=(("x", "y"), np.ones((4, 3), np.int8), {"flag_meanings": "a b", "flag_values": np.int8([0, 1])})
)


def test_unknown_options_of_other_figures_are_refused():
    with pytest.raises(BadInput, match="figure: widht: no such option; did you mean 'width'"):
        atlas.figure([FLAGS], widht=85)
    with pytest.raises(BadInput, match="plot: degree: no such option; did you mean 'degrees'"):
        FLAGS.atlas.plot(degree=True)
    with pytest.raises(BadInput, match="diagram: colour: no such option; allowed: variable, ax"):
        FLAGS.atlas.diagram(colour=True)
