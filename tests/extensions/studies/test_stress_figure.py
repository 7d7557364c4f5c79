"""The figure of a stress study shows every verdict and mark, and explains them."""

from itertools import pairwise

import numpy as np
import pytest
from matplotlib.colors import to_hex, to_rgb
from matplotlib.patches import Patch

from atlas.extensions.studies import figures as stress_figure
from atlas.extensions.studies import stress
from atlas.extensions.studies.stress import Verdict
from atlas.systems import SYSTEMS
from atlas.systems.base import stress_cases_of


@pytest.fixture(scope="module")
def study():
    """Cases that are right, unresolved and left out."""
    system = SYSTEMS["fixed_point"]
    ds = stress.stress(system, [c for c in stress_cases_of(system) if c.name in ("near 0", "overflow")])
    assert set(np.unique(ds.verdict)) == {Verdict.RIGHT, Verdict.UNRESOLVED, Verdict.LEFT_OUT}
    return ds


@pytest.mark.long
def test_each_panel_has_one_scale_and_all_points(study):
    axes = stress_figure.stress_figure(study).axes
    assert [ax.get_title("left") for ax in axes] == ["rk4", "", "rk8", ""]
    for i, ax in enumerate(axes):
        levels = slice(0, len(stress.RATIOS)) if i % 2 == 0 else slice(len(stress.RATIOS), None)
        ticks = [float(tick.get_text()) for tick in ax.get_xticklabels()]
        assert ticks == [*stress.RATIOS] if i % 2 == 0 else [*stress.TOLERANCES]
        verdict = study.verdict.values[i // 2, levels].T
        np.testing.assert_array_equal(np.reshape(ax.collections[0].get_array(), verdict.shape), verdict)
        assert len(ax.patches) == (verdict == Verdict.LEFT_OUT).sum()
        dots = ax.lines[0].get_xydata()
        assert len(dots) == ((verdict == Verdict.RIGHT) & (study.error.values[i // 2, levels].T < 0.01)).sum()


@pytest.mark.long
def test_names_do_not_touch(study):
    figure = stress_figure.stress_figure(study)
    figure.canvas.draw()
    boxes = [label.get_window_extent() for label in figure.axes[0].get_yticklabels()]
    assert all(upper.y0 > lower.y1 for upper, lower in pairwise(boxes))


def test_every_mark_is_in_the_legend(study):
    figure = stress_figure.stress_figure(study)
    (legend,) = figure.legends
    texts = [text.get_text() for text in legend.get_texts()]
    assert [text.split(":")[0] for text in texts[:4]] == ["right", "unresolved", "wrong", "left out"]
    marks = [line.get_marker() for line in legend.get_lines()]
    assert marks == [line.get_marker() for line in figure.axes[0].lines]


def test_the_legend_names_the_verdict_of_every_cell(study):
    """Rows are the points of the case whose name is beside them, columns the levels below."""
    figure = stress_figure.stress_figure(study)
    (legend,) = figure.legends
    texts = {
        to_hex(patch.get_facecolor()): text.get_text()
        for text, patch in zip(legend.get_texts(), legend.legend_handles, strict=True)
        if isinstance(patch, Patch)
    }
    cases = {
        tick.get_text(): place
        for tick, place in zip(figure.axes[0].get_yticklabels(), figure.axes[0].get_yticks(), strict=True)
    }
    names = [name.replace("_", " ") for name in Verdict.meanings()]
    beyond = stress.beyond_estimate(study)
    for i, ax in enumerate(figure.axes):
        mesh, first = ax.collections[0], 0 if i % 2 == 0 else len(stress.RATIOS)
        edges = mesh.get_coordinates()[:, 0, 1]
        for row, column in np.ndindex(np.shape(mesh.get_array())):
            verdict = int(study.verdict[i // 2, first + column, row])
            colour = to_hex(mesh.cmap(mesh.norm(np.asarray(mesh.get_array())[row, column])))
            assert texts[colour].partition(":")[0] == names[verdict]
            rows = np.flatnonzero(study.case.values == study.case.values[row])
            place = cases[str(study.case.values[row])]
            assert place == pytest.approx(0.5 * (edges[rows[0]] + edges[rows[-1] + 1]))
        crosses = np.argwhere(beyond[i // 2, first : first + np.shape(mesh.get_array())[1]].T)
        drawn = ax.lines[1].get_xydata()
        assert sorted(drawn[:, 0].tolist()) == sorted((crosses[:, 1] + 0.5).tolist())
    texts = [text.get_text() for text in legend.get_texts()]
    assert "within 1 %" in texts[-2]
    assert texts[-1] == "a statistic off by more than ten times error_estimate"


def test_verdicts_differ_in_luminance():
    grey = [
        np.dot(to_rgb(colour), (0.2126, 0.7152, 0.0722)) for colour in stress_figure.VERDICT_COLOURS.values()
    ]
    assert np.diff(np.sort(grey)).min() > 0.08
