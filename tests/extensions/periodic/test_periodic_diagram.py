"""Diagrams of families, and the command that draws them."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure
from readers import entries

import atlas
from atlas import cli
from atlas.flags import PeriodicEvent
from tests.refusals import assert_refused, assert_refused_in_shell

pytestmark = pytest.mark.usefixtures("whole_kernels")

BODY = {"A": 1.0, "B": 1.0, "C": 1.5, "k3": 0.3, "mu3": 0.5, "h3": 0.6}
MOTION = {"family": "perp_radius", "solve": ["m"], "theta0": 0.9}


@pytest.fixture(scope="module")
def nutations():
    return atlas.periodic("satellite", BODY, motion=MOTION, frequency=1, max_period=1.3)


@pytest.mark.long
@pytest.mark.parametrize("y", ["period", "amplitude", "energy"])
def test_lines_are_full_up_to_the_doubling_and_dashed_after_it(nutations, y):
    figure = nutations.atlas.periodic_diagram(y)
    full, dashed = (
        [
            line
            for line in figure.axes[0].lines
            if line.get_linestyle() == kind and line.get_marker() == "None"
        ]
        for kind in ("-", "--")
    )
    doubling = nutations.event_arc.values[nutations.event_kind.values == PeriodicEvent.DOUBLING].min()
    step = np.diff(nutations.arc.values[0]).max()
    assert max(full[0].get_xdata()) == pytest.approx(doubling, abs=2 * step)
    assert min(dashed[0].get_xdata()) == pytest.approx(doubling, abs=2 * step)
    amplitude = (nutations.theta_max - nutations.theta_min).rename("amplitude")
    values = (amplitude if y == "amplitude" else nutations[y]).values
    assert set(full[0].get_ydata()) <= set(values[0])
    marks = [line for line in figure.axes[0].lines if line.get_marker() == "^" and len(line.get_xdata())]
    assert doubling in marks[0].get_xdata()
    texts = [text.get_text() for text in figure.legends[0].texts]
    assert texts[0].startswith(r"$\omega$ = 1.29: period limit")


def test_the_legend_names_the_family_of_every_line_and_the_event_of_every_marker(nutations):
    """As a person reads them: a line by its colour, a marker by its shape."""
    both = xr.concat(
        [nutations, nutations.assign(frequency=0.5 * nutations.frequency, period=2 * nutations.period)],
        "family",
    )
    figure = both.atlas.periodic_diagram()
    legend = entries(figure)
    samples = {sample.get_color(): text for text, sample in legend.items() if sample.get_marker() == "None"}
    names = {sample.get_marker(): text for text, sample in legend.items() if sample.get_marker() != "None"}
    for line in figure.axes[0].lines:
        arcs, values = line.get_data()
        if not len(arcs):  # samples of the legend
            continue
        if line.get_marker() == "None":
            (k,) = {int(each) for each in np.argwhere(np.isin(both.period.values, values))[:, 0]}
            assert samples[line.get_color()].startswith(rf"$\omega$ = {both.frequency.values[k]:.4g}:")
        else:
            kind = PeriodicEvent[names[line.get_marker()].upper().replace(" ", "_")]
            assert set(arcs) <= set(both.event_arc.values[both.event_kind.values == kind])


def test_axes_of_the_caller_are_drawn_into_and_the_wrong_datasets_refused(nutations):
    axes = Figure().subplots()
    assert nutations.atlas.periodic_diagram(ax=axes, legend=False) is axes.figure
    sentence = "periodic_diagram: needs families of one body from atlas.periodic; choose one by sel or isel"
    assert_refused(lambda: xr.Dataset({"period": ("orbit", [1.0])}).atlas.periodic_diagram(), sentence)
    assert_refused(lambda: nutations.expand_dims(k1=[1.0]).atlas.periodic_diagram(), sentence)
    assert_refused(lambda: nutations.atlas.periodic_diagram("turn"), "periodic_diagram: 'turn': allowed: ...")


SCENE = """
schema = 1
title = "Nutations"
system = "satellite"
[fixed]
A = 1.0
B = 1.0
C = 1.5
mu3 = 0.5
h3 = 0.6
k3 = 0.3
[axes.theta0]
values = [0.9, 1.0]
[family]
name = "perp_radius"
solve = ["m"]
[integration]
duration = "2 orbits"
"""


@pytest.mark.long
def test_the_command_draws_and_writes_families_of_a_motion_of_a_scene(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.toml").write_text(SCENE)
    for out in ("nutations.nc", "nutations.svg"):
        command = [
            "periodic",
            "scene.toml",
            "--at",
            "theta0=0.9",
            "--frequency",
            "1",
            "--orbits",
            "8",
            "-o",
            out,
        ]
        assert cli.main(command) == cli.DONE
    assert "families: 1, of at most 8 orbits; wrote nutations.svg" in capsys.readouterr().out
    with xr.open_dataset("nutations.nc") as ds:
        assert ds.sizes["orbit"] == 8
        assert ds.frequency.item() == pytest.approx(1.2899078641286588, rel=1e-10)
    for at, sentence in (
        ("", "theta0: has no value; a family needs a value of every axis: theta0"),
        ("--at theta0=0.9 C=1", "C: is no axis of the scene; a family needs a value of every axis: theta0"),
        ("--at theta0=0.9 --frequency 5", "frequency = 5: the motion has 1..., in positions from 1 on"),
    ):
        assert_refused_in_shell(f"periodic scene.toml {at}", sentence, capsys)
