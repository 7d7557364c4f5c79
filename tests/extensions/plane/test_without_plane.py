"""Motions in the plane where the extension is missing: nothing is predicted that it alone could judge, and no label contradicts."""

import re

import numpy as np
import pytest
from strategies import default_points

import atlas
from atlas import BadInput
from atlas.flags import Label, Status
from atlas.systems.base import families_of, rate_std
from atlas.systems.satellite import SATELLITE
from atlas.systems.steady import lacks_theory
from atlas.variables import variables

SCENE = """
schema = 1
system = "satellite"
[fixed]
A = 1.0
B = 1.3
[axes.psi0]
values = [0.2, 0.8]
[family]
name = "plane_libration"
[integration]
duration = 5.0
"""
KINDS = (
    "librations and rotations",
    "across",
    "damped",
    "tilted",
    "fast rotations",
    "small librations",
    "steady",
)


def starts(count, seed):
    """Starts of each of the KINDS, about the normal or against it, and the kind of each."""
    rng, kind = np.random.default_rng(seed), np.arange(count) % len(KINDS)
    parts = rng.uniform(0.4, 1, (3, count))
    p = dict(zip("ABC", parts.sum(0) - parts, strict=True))
    p |= {name: rng.normal(size=count) for name in ("k3", "h3", "n", "m")}
    p |= {
        "mu3": rng.uniform(0, 1, count),
        "phi0": rng.uniform(-4, 4, count),
        "psi0": rng.uniform(-4, 4, count),
    }
    p["theta0"] = np.where(
        kind == 3, rng.uniform(0.1, 3, count), np.where(rng.random(count) < 0.5, 0.0, np.pi)
    )
    p |= {"k1": np.where(kind == 1, 0.3, 0.0), "damping": np.where(kind == 2, 0.1, 0.0)}
    sign, bottom = np.where(p["theta0"] == 0, 1, -1), np.where(p["A"] < p["B"], 0.0, np.pi / 2)
    p["m"] = np.where(kind == 4, 15 * rng.uniform(0.5, 3, count) * rng.choice([-1, 1], count), p["m"])
    small = np.where(kind == 5, 10.0 ** rng.uniform(-8, -3, count), 0.0)
    p["psi0"] = np.where(kind >= 5, sign * (bottom + small - p["phi0"]), p["psi0"])
    p["m"] = np.where(kind >= 5, -sign * p["n"], p["m"])
    return default_points("satellite", count, **p), kind


@pytest.mark.usefixtures("whole_kernels")
def test_no_label_contradicts_and_nothing_is_predicted(without_extension):
    points, kind = starts(140, seed=1)

    def labels():
        return atlas.label_points(
            "satellite",
            points,
            duration=120.0,
            rate_tolerance=1e-2,
            tolerance=1e-6,
            method="rk8",
            progress=False,
        )

    whole = labels()
    in_plane = np.isin(whole.family, [f.flag for f in families_of(SATELLITE).values() if f.rate_std])
    assert not lacks_theory(SATELLITE, points).any()
    assert "atlas_warnings" not in whole.attrs
    without_extension("plane")
    ds, alone = labels(), lacks_theory(SATELLITE, points)
    assert alone[in_plane].all()
    np.testing.assert_array_equal(
        alone, in_plane | (kind == 2)
    )  # one that is damped could be of such a family
    assert "nothing is predicted there" in ds.attrs["atlas_warnings"]
    assert "atlas_extensions" not in ds.attrs
    np.testing.assert_array_equal(ds.family, np.where(in_plane, 0, whole.family))
    for name in ("predicted", "predicted_inertial"):
        np.testing.assert_array_equal(ds[name], np.where(alone, Label.NOT_COMPUTED, whole[name]))
    for name in ("label", "label_inertial"):
        np.testing.assert_array_equal(ds[name][~alone], whole[name][~alone])
        # Theory knows the growth of errors, without which a label on the vertical may be given, or another one not.
        resolved = (ds[name] != Label.UNRESOLVED) & (whole[name] != Label.UNRESOLVED)
        np.testing.assert_array_equal(ds[name][resolved], whole[name][resolved])
    for name in ("theta_dot_rms", "theta_max", "normal_rate_mean", "normal_rate_std", "integral_drift"):
        np.testing.assert_array_equal(ds[name], whole[name])
    assert (whole.status.values[in_plane] == Status.ROUNDOFF_DECIDED).sum() > 2
    assert (ds.label.values[alone] != Label.UNRESOLVED).sum() > 40


def test_a_scene_of_its_family_is_refused_in_one_line(without_extension):
    scene = atlas.load_scene(SCENE)
    without_extension("plane")
    with pytest.raises(BadInput, match=r"^family\.name = 'plane_libration': of a missing extension"):
        atlas.load_scene(SCENE)
    with pytest.raises(BadInput, match=r"^extensions: 'plane' is not installed") as error:
        atlas.load_scene(re.sub("schema = 1", 'schema = 1\nextensions = ["plane"]', SCENE))
    assert len(str(error.value).splitlines()) == 1
    assert scene.family == "plane_libration"


def test_what_varies_is_what_the_rule_asks_for():
    """A start that the rule leaves out belongs to no family: its rate does not vary, or its axis is tilted at once."""
    points, kind = starts(700, seed=2)
    flags, _ = SATELLITE.identify_family(points)
    varies = rate_std(SATELLITE, points, flags, np.full(flags.size, np.inf)) > 0
    assert set(kind[varies]) == {0, 4, 5}


def test_flags_of_families_are_reserved(without_extension):
    flags = {name: family.flag for name, family in families_of(SATELLITE).items()}
    meanings = variables(SATELLITE)["family"].flags
    assert list(flags) == list(meanings)[1:]
    without_extension("plane")
    assert families_of(SATELLITE).keys() == flags.keys() - {"plane_libration", "plane_rotation"}
    assert variables(SATELLITE)["family"].flags == meanings
