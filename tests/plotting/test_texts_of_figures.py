"""No text of a figure lies over another one or leaves the figure, whatever its width."""

import itertools
import tomllib
from collections import Counter
from unittest.mock import patch

import pytest
from installed import example_scenes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox

import atlas
from atlas.plotting import cells

pytestmark = pytest.mark.usefixtures("whole_kernels", "coarse_lines")

COUNT = 6  # values of each axis
INERTIAL = "label_inertial"


def boxes(figure: Figure) -> dict[str, list[Bbox]]:
    """Boxes of all texts that are drawn, in dots, by the text."""
    found: dict[Text, Bbox] = {}
    draw = Text.draw

    def record(text: Text, renderer, *arguments, **options):
        if text.get_visible() and text.get_text().strip():
            found[text] = text.get_window_extent(renderer)
        return draw(text, renderer, *arguments, **options)

    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # settles the layout
    with patch.object(Text, "draw", record):
        canvas.draw()
    by_text: dict[str, list[Bbox]] = {}
    for text, box in found.items():
        by_text.setdefault(text.get_text(), []).append(box)
    return by_text


def faults(figure: Figure) -> list[str]:
    """Pairs of texts that overlap by more than half a dot, and texts that leave the figure."""
    drawn = [(text, box) for text, group in boxes(figure).items() for box in group]
    page = figure.bbox.padded(0.5)
    bad = [f"{text!r} leaves the figure" for text, box in drawn if page.count_contains(box.corners()) != 4]
    for (first, a), (second, b) in itertools.combinations(drawn, 2):
        common = Bbox.intersection(a.padded(-0.25), b.padded(-0.25))
        if common is not None and common.width > 0 and common.height > 0:
            bad.append(f"{first!r} over {second!r}")
    return bad


def legend_rows(figure: Figure) -> int:
    """Rows of a legend above the panels: the most texts that begin below each other."""
    texts = [text for legend in figure.legends for text in legend.get_texts()]
    lefts = Counter(round(text.get_transform().transform(text.get_position())[0]) for text in texts)
    return max(lefts.values(), default=0)


@pytest.fixture(scope="module")
def example_atlas():
    """Atlases of example scenes at small counts, by the name of the scene, each run once."""
    done = {}

    def run(path):
        if path.stem not in done:
            scene = tomllib.loads(path.read_text())
            for axis in scene.get("axes", {}).values():
                if "count" in axis:
                    axis["count"] = min(axis["count"], COUNT)
            scene.get("points", {}).update({"count": 64} if "sample" in scene.get("points", {}) else {})
            scene.pop("refine", None)
            done[path.stem] = atlas.run(scene, progress=False).load()
        return done[path.stem]

    return run


def check(ds, width: float) -> None:
    """One panel, and two of label in both frames or of label and agreement, at a width in mm."""
    figures = {"one panel": ds.atlas.map(width=width)}
    second = INERTIAL if INERTIAL in ds else "agreement"
    if {"label", second} <= {*ds} and ds["label"].ndim <= 2:
        panels = {"orbital frame": (ds, "label"), "inertial space": (ds, second)}
        figures["two panels"] = atlas.figure(panels, width=width)
    for name, figure in figures.items():
        assert (name, faults(figure)) == (name, [])
        assert width < 85 or legend_rows(figure) <= 3, name


@pytest.mark.usual("quickstart")
@pytest.mark.parametrize("path", example_scenes(), ids=lambda path: path.stem)
def test_no_text_lies_over_another_in_one_column(example_atlas, path):
    check(example_atlas(path), 85)


@pytest.mark.long
@pytest.mark.parametrize("width", range(80, 181, 20))
@pytest.mark.parametrize("path", example_scenes(), ids=lambda path: path.stem)
def test_no_text_lies_over_another_at_any_width(example_atlas, path, width):
    check(example_atlas(path), width)


def test_texts_that_overlap_or_leave_are_found():
    figure = Figure()
    figure.text(0.5, 0.5, "one")
    assert faults(figure) == []
    figure.text(0.51, 0.5, "two")
    figure.text(0.99, 0.9, "three")
    assert faults(figure) == ["'three' leaves the figure", "'one' over 'two'"]


def test_lines_of_all_figures_of_a_series_have_one_width():
    """Whatever their number, and however near they are to each other."""
    for width, share in ((cells.NARROW, 1.0), (cells.NARROW - 1, cells.THINNER)):
        for kind, style in cells.BORDERS.items():
            assert cells.border_style(kind, width)["linewidth"] == share * style["linewidth"]
        assert cells.family_style(0, width)["linewidth"] == share
