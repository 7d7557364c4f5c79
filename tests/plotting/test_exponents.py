"""Maps of regular and chaotic motion."""

import numpy as np
import pytest
import xarray as xr

import atlas
from atlas.plotting.maps import atlas_map

pytestmark = pytest.mark.usefixtures("whole_kernels")

FLAGS = {"regular": 2, "chaotic": 3, "undecided": 4, "steady": 1}


@pytest.fixture(scope="module")
def librations():
    """A map of librations whose flags and exponents are set by hand, so that all of them occur."""
    scene = """
    schema = 1
    system = "satellite"
    fixed = {A = 1.0, B = 1.3, C = 1.6}
    axes.psi0 = {from = 0.1, to = 1.4, count = 8}
    axes.theta0 = {from = 0.1, to = 0.5, count = 5}
    integration = {duration = "2 orbits"}
    outputs.variables = ["label", "status", "regularity", "lyapunov"]
    """
    ds = atlas.run(atlas.load_scene(scene), progress=False).load()
    flags = np.full(ds.label.shape, FLAGS["regular"], np.int8)
    flags[2:4], flags[4:6], flags[6] = FLAGS["chaotic"], FLAGS["undecided"], FLAGS["steady"]
    ds["regularity"] = ds.regularity.copy(data=flags)
    ds["lyapunov"] = ds.lyapunov.copy(data=np.linspace(0.01, 0.2, flags.size).reshape(flags.shape))
    return ds


def legend(figure):
    return [entry.get_text() for legend in figure.legends for entry in legend.get_texts()]


@pytest.mark.long
def test_chaotic_cells_are_shaded_by_their_exponents(librations):
    figure = atlas_map(librations, "regularity")
    shades = [mesh for mesh in figure.axes[0].collections if np.ma.count_masked(mesh.get_array())]
    assert len(shades) == 1
    drawn = shades[0].get_array()
    assert drawn.count() == (librations.regularity == FLAGS["chaotic"]).sum()
    exponents = librations.lyapunov.where(librations.regularity == FLAGS["chaotic"])
    assert shades[0].norm.vmin == pytest.approx(float(exponents.min()))
    assert shades[0].norm.vmax == pytest.approx(float(exponents.max()))
    assert len(figure.axes) == 2
    assert "Lyapunov exponent" in figure.axes[1].get_ylabel()


def test_the_legend_states_how_long_the_runs_were(librations):
    assert legend(atlas_map(librations, "regularity"))[:4] == [
        "steady", "regular up to 2 orbits", "chaotic up to 2 orbits", "undecided",
    ]  # fmt: skip
    renamed = atlas_map(librations, "regularity", labels={"chaotic": "chaos"})
    assert "chaos" in legend(renamed)


def test_undecided_cells_are_hatched(librations):
    def hatches(ds: xr.Dataset) -> int:
        return sum(bool(each.get_hatch()) for each in atlas_map(ds, "regularity").axes[0].collections)

    decided = librations.assign(regularity=librations.regularity.where(librations.regularity != 4, 2))
    decided["regularity"] = decided.regularity.astype(np.int8).assign_attrs(librations.regularity.attrs)
    assert hatches(librations) == hatches(decided) + 1


def test_maps_without_exponents_or_without_chaos_have_no_bar(librations):
    assert len(atlas_map(librations.drop_vars("lyapunov"), "regularity").axes) == 1
    calm = librations.assign(
        regularity=librations.regularity.copy(data=np.full(librations.label.shape, 2, np.int8))
    )
    assert len(atlas_map(calm, "regularity").axes) == 1
