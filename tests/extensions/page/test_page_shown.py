"""What a reader of a page sees of a point, of a map and of a motion, read from its canvases and texts, is what was measured."""

import re

import numpy as np
import pytest
from extensions.page.test_in_browser import DONE, pixel
from extensions.page.test_page import table_of, unpacked
from readers import lines_of

from atlas.analysis.boundary import STABILITY
from atlas.analysis.metadata import flag_names, system_of
from atlas.extensions.page.page import atlas_page
from atlas.plotting import style
from atlas.plotting.content import SLOW
from atlas.variables import data_variables

# What is drawn on every canvas from now on: lines with their ink, texts and filled boxes, in the pixels of the canvas.
RECORDER = """(() => {
  window.drawn = [];
  const proto = CanvasRenderingContext2D.prototype;
  const wrap = (name, note) => {
    const own = proto[name];
    proto[name] = function (...args) { note.call(this, ...args); return own.apply(this, args); };
  };
  const place = (context, x, y) => { const m = context.getTransform(); return [m.a * x + m.c * y + m.e, m.b * x + m.d * y + m.f]; };
  wrap("beginPath", function () { this.path = []; });
  wrap("moveTo", function (x, y) { this.path.push([...place(this, x, y), 0]); });
  wrap("lineTo", function (x, y) { this.path.push([...place(this, x, y), 1]); });
  wrap("stroke", function () { drawn.push({ kind: "line", on: this.canvas, ink: this.strokeStyle, width: this.lineWidth, path: this.path.slice() }); });
  wrap("fillText", function (text, x, y) { drawn.push({ kind: "text", on: this.canvas, text, align: this.textAlign, path: [place(this, x, y)] }); });
  wrap("fillRect", function (x, y, w, h) { drawn.push({ kind: "box", on: this.canvas, ink: this.fillStyle, path: [[...place(this, x, y), w, h]] }); });
})()"""


def drawn(browser, canvas: str, action: str) -> list[dict]:
    """What an action draws on a canvas, given by an expression."""
    if browser.evaluate("typeof drawn") == "undefined":
        browser.evaluate(RECORDER)
    return browser.evaluate(
        f"(() => {{ drawn.length = 0; {action}; const own = {canvas};"
        " return drawn.filter(each => each.on === own).map(({ on, ...rest }) => rest); })()"
    )


def texts(marks: list[dict]) -> dict[str, tuple[float, float]]:
    """Texts on a canvas with their places."""
    return {mark["text"]: tuple(mark["path"][0]) for mark in marks if mark["kind"] == "text"}


def value(text: str) -> float:
    """A number as the page prints it."""
    raised = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹\N{MINUS SIGN}", "-0123456789-")
    text = text.replace(" \N{MULTIPLICATION SIGN} ", "\N{MULTIPLICATION SIGN}")
    if match := re.fullmatch(r"(?:(\S+)\N{MULTIPLICATION SIGN})?10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)", text):
        return float((match[1] or "1").translate(raised)) * 10.0 ** int(match[2].translate(raised))
    others = {"\N{EN DASH}": np.nan, "\N{INFINITY}": np.inf}
    return others[text] if text in others else float(text.translate(raised))


def axis(marks: list[dict], which: int, align: str) -> np.ndarray:
    """The line through the ticks of an axis: value over pixel, (slope, intercept)."""
    places = []
    for mark in marks:
        if mark["kind"] == "text" and mark["align"] == align:
            try:
                places.append((mark["path"][0][which], value(mark["text"])))
            except ValueError:
                continue
    pixels, values = np.array(places).T
    line = np.polyfit(pixels, values, 1)
    np.testing.assert_allclose(np.polyval(line, pixels), values, atol=0.02 * np.ptp(values))
    return line


def of_menu(name: str) -> str:
    """Show a variable."""
    return (
        "const menu = document.getElementById('variable');"
        f" menu.value = String(data.variables.findIndex(each => each.name === '{name}'));"
        " menu.dispatchEvent(new Event('change'))"
    )


def texts_of(browser, selector: str) -> list[str]:
    return browser.evaluate(f"[...document.querySelectorAll({selector!r})].map(each => each.textContent)")


LABELS = {
    "label": "label", "predicted": "predicted", "growth_rate": "growth rate (rad s⁻¹)", "theta_max": "largest θ (rad)",
    "psi_dot_mean": "mean ψ̇ (rad s⁻¹)", "end_time": "end time (s)", "error_estimate": "error estimate",
}  # fmt: skip


@pytest.mark.long
def test_the_table_names_variables_axes_and_flags(small_atlas, small_page):
    table = table_of(small_page.html)
    variables = {each["name"]: each for each in table["variables"]}
    assert {name: variables[name]["plain"] for name in LABELS} == LABELS
    assert [(axis["plain"], axis["name"]) for axis in table["axes"]] == [
        ("C/A", "sigma"),
        ("θ₀ (rad)", "theta0"),
    ]
    assert table["map"] == [0, 1]
    for name, each in variables.items():
        if not each.get("flags"):
            continue
        names = flag_names(small_atlas[name])
        assert [flag["name"] for flag in each["flags"]] == names
        assert [flag["text"] for flag in each["flags"]] == [flag.replace("_", " ") for flag in names]
        assert [flag["colour"] for flag in each["flags"]] == list(style.flag_colours(names).values())
    groups = {name: each["group"] for name, each in variables.items()}
    assert {name: groups[name] for name in ("label", "theta_max", "predicted", "growth_rate", "status", "step")} == {
        "label": "motion", "theta_max": "motion", "predicted": "theory", "growth_rate": "theory", "status": "numerics",
        "step": "numerics",
    }  # fmt: skip
    sentences = {flag["name"]: flag["sentence"] for flag in variables["label"]["flags"]}
    assert sentences == dict(data_variables(system_of(small_atlas))["label"].flags)
    assert sentences["drifting"] == "theta, psi' or phi' varies"


@pytest.mark.long
def test_slow_points_and_parameters_of_the_table(small_atlas, small_page):
    table = table_of(small_page.html)
    arrays = [unpacked(entry) for entry in table["arrays"]]

    def over_points(reference):
        shape = [table["shape"][axis] if axis in reference["over"] else 1 for axis in (0, 1)]
        return np.broadcast_to(arrays[reference["array"]].reshape(shape), table["shape"])

    ds = small_atlas
    steady, grown = ds.label.isin([1, 2]), ds.growth_rate * ds.end_time
    np.testing.assert_array_equal(
        over_points(table["theory"]["slow"]), steady & (ds.stable == 2) & (grown < 12)
    )
    for parameter in table["motion"]["parameters"]:
        name = parameter["name"]
        change = {"theta0": 1e-4, "psi0": 1e-4}.get(name, 0.0)  # the nudge
        expected = ds[name].broadcast_like(ds.label).transpose("sigma", "theta0") + change
        np.testing.assert_allclose(over_points(parameter["values"]), expected, rtol=1e-12, err_msg=name)
    np.testing.assert_array_equal(over_points(table["motion"]["duration"]), 30.0)


@pytest.mark.parametrize("name", ["label", "agreement", "stable"])
def test_the_legend_has_the_share_of_every_flag(browser, address, small_atlas, name):
    browser.open(address)
    browser.evaluate(f"(() => {{ {of_menu(name)} }})()")
    values, names = small_atlas[name].values, flag_names(small_atlas[name])
    shares = {names[v].replace("_", " "): 100 * (values == v).mean() for v in np.unique(values)}
    found = {}
    for item in texts_of(browser, "#legend li"):
        if match := re.fullmatch(r"(.*?)([\d.]+|< 0\.1) %", item):
            found[match[1]] = float(match[2])
    steady, grown = small_atlas.label.isin([1, 2]), small_atlas.growth_rate * small_atlas.end_time
    slow = 100 * float((steady & (small_atlas.stable == 2) & (grown < 12)).mean())
    assert found.get(SLOW) == (None if name == "stable" else pytest.approx(slow, abs=0.5))
    for text, share in shares.items():
        assert found.pop(text) == pytest.approx(share, abs=0.5), text
    assert set(found) <= {SLOW}
    assert any(text.startswith(STABILITY) for text in texts_of(browser, "#legend li"))


@pytest.mark.parametrize("degrees", [False, True])
def test_the_values_of_a_point_stand_beside_their_names(browser, small_atlas, tmp_path, quick_page, degrees):
    path = tmp_path / "values.html"
    atlas_page(small_atlas, degrees=degrees).save(path)
    browser.open(path.as_uri())
    point = small_atlas.isel(sigma=6, theta0=2)
    rows, head, badges = browser.evaluate(
        "(() => { showPoint([6, 2]); const rows = [...document.querySelectorAll('#values tr')].map(row =>"
        " [row.querySelector('th').title.split(':')[0], row.querySelector('th').textContent, row.querySelector('td').textContent]);"
        " const badges = [...document.querySelectorAll('#verdict .badge')].map(each => each.textContent);"
        " return [rows, document.getElementById('place').textContent, badges]; })()"
    )
    assert {name for name, _, _ in rows} >= {*small_atlas.data_vars} - {"label", "label_inertial"}
    for name, text, shown in rows:
        array = point[name]
        if flags := flag_names(array):
            assert shown == flags[int(array)].replace("_", " "), name
            continue
        is_angle = array.attrs.get("units") == "rad"
        size = 180 / np.pi if degrees and is_angle else 1.0
        nudge = 1e-4 if name in ("theta0", "psi0") else 0.0
        assert value(shown) == pytest.approx(size * (float(array) + nudge), rel=1e-5, abs=0, nan_ok=True), (
            name
        )
        if is_angle:
            assert text.endswith("(deg)" if degrees else "(rad)")
    theta0 = re.fullmatch(r"C/A = 1\.35, θ0 = (\S+)", head)[1]
    assert float(theta0) == pytest.approx(float(point.theta0) * (180 / np.pi if degrees else 1), rel=1e-5)
    names = flag_names(point.label)
    assert badges == [
        f"{names[int(point.label)].replace('_', ' ')} (orbital frame)",
        f"{names[int(point.label_inertial)].replace('_', ' ')} (inertial frame)",
    ]


def test_cells_are_beside_the_ticks_of_their_values(browser, address, small_atlas):
    """Axes, and colours of cells by the flags of the table and by the bar."""
    browser.open(address)
    marks = drawn(browser, "map", of_menu("label"))
    across, up = axis(marks, 0, "center"), axis(marks, 1, "right")
    for i, j in ((0, 0), (8, 0), (3, 6), (7, 2)):
        x, y = browser.evaluate(f"pixelOf([{i}, {j}])")
        assert np.polyval(across, x) == pytest.approx(float(small_atlas.sigma[i]), abs=0.01)
        assert np.polyval(up, y) == pytest.approx(float(small_atlas.theta0[j]), abs=0.01)
        assert browser.evaluate(f"indexAt({x}, {y})") == [i, j]
        shade = browser.evaluate(
            f"[...document.getElementById('map').getContext('2d').getImageData({round(x)}, {round(y)}, 1, 1).data]"
        )
        flag = flag_names(small_atlas.label)[int(small_atlas.label[i, j])]
        colour = style.COLOURS[flag].lstrip("#")
        assert shade[:3] == [int(colour[k : k + 2], 16) for k in (0, 2, 4)]


@pytest.mark.parametrize("name", ["growth_rate", "psi_dot_mean", "theta_max", "theta_dot_rms"])
def test_a_cell_has_the_colour_that_the_bar_has_at_its_value(browser, address, small_atlas, name):
    browser.open(address)
    marks = drawn(browser, "map", of_menu(name))
    boxes = [(m["path"][0], m["ink"]) for m in marks if m["kind"] == "box" and m["path"][0][2] == 12]
    assert len(boxes) > 100
    left = boxes[0][0][0]
    bar = [
        m
        for m in marks
        if m["kind"] == "text" and m["align"] == "left" and abs(m["path"][0][0] - left - 17) < 1
    ]
    pixels, ticks = np.array([(m["path"][0][1], value(m["text"])) for m in bar]).T
    is_log = ticks.min() > 0 and np.ptp(np.diff(ticks)) > 1e-6 * np.ptp(ticks)
    scale = np.polyfit(np.log(ticks) if is_log else ticks, pixels, 1)
    assert scale[0] < 0  # larger values are higher
    tops = np.array([box[1] for box, _ in boxes])
    heights = np.array([box[3] for box, _ in boxes])
    for i, j in ((0, 0), (6, 2), (8, 5), (4, 3)):
        number = float(small_atlas[name][i, j])
        if number <= 0 and is_log:
            continue
        y = np.clip(
            np.polyval(scale, np.log(number) if is_log else number),
            tops.min() + 1,
            (tops + heights).max() - 1,
        )
        colour = browser.evaluate(f"css(cells().colours[{j} * 9 + {i}])")
        inks = [int(n) for n in re.findall(r"\d+", colour)]
        near = [
            ink
            for ink, top, height in zip((ink for _, ink in boxes), tops, heights, strict=True)
            if top - 2 <= y <= top + height + 2
        ]
        assert any(
            max(abs(int(ink[1 + 2 * k : 3 + 2 * k], 16) - inks[k]) for k in range(3)) <= 6 for ink in near
        ), (i, j)


def test_lines_of_theory_are_where_the_map_of_the_atlas_has_them(browser, address, small_atlas):
    """And on maps of the kinds of motion in space those of the labels there."""
    figure = small_atlas.atlas.map("stable")
    (line,) = lines_of(figure, figure.axes[0], STABILITY)
    expected = line[np.isfinite(line).all(1)]
    browser.open(address)
    for name in ("stable", "growth_rate", "label"):
        marks = drawn(browser, "map", of_menu(name))
        across, up = axis(marks, 0, "center"), axis(marks, 1, "right")
        inked = [
            m["path"] for m in marks if m["kind"] == "line" and m["ink"] == "#000000" and len(m["path"]) > 5
        ]
        x, y = np.array([point[:2] for path in inked for point in path]).T
        places = np.stack([np.polyval(across, x), np.polyval(up, y)], -1)
        assert np.abs(places[:, None] - expected).max(-1).min(1).max() < 0.02
        assert np.abs(expected[:, None] - places).max(-1).min(1).max() < 0.02
    lines = browser.evaluate("data.theory.slices[0].map(line => [line.kind, line.on, line.source])")
    assert [STABILITY, ["frame", "limits"], "theory"] in lines
    assert all(
        set(on) <= {"frame", "limits"} or set(on) == {"inertial"} or source == "exact"
        for _, on, source in lines
    )
    variables = browser.evaluate("data.variables.map(each => [each.name, each.lines])")
    shown = dict(variables)
    names = ("label", "label_inertial", "predicted_inertial", "theta_max", "stable")
    assert [shown[name] for name in names] == ["frame", "inertial", "inertial", "limits", "limits"]


def test_white_cells_have_their_reason_and_share(browser, small_atlas, tmp_path, quick_page):
    ds = small_atlas.copy(deep=True)
    ds["label"][:3] = ds["status"][:3] = 0
    ds["status"][0] = flag_names(ds.status).index("impossible_body")
    ds["label_inertial"][:3] = 0
    path = tmp_path / "white.html"
    atlas_page(ds).save(path)
    browser.open(path.as_uri())
    items = texts_of(browser, "#legend li")
    assert "no such body11 %" in items
    assert "no such motion22 %" in items
    browser.evaluate("showPoint([0, 0])")
    verdict = browser.evaluate("(() => { showPoint([0, 0]); return byId('verdict').textContent; })()")
    assert "Status: impossible body: " in verdict
    fine = browser.evaluate("(() => { showPoint([8, 0]); return byId('verdict').textContent; })()")
    assert "Status: integrated and resolved." in fine


def curve_of(marks: list[dict]) -> np.ndarray:
    """The longest line on a canvas, in the values of the ticks: across from the top and from the left."""
    line = max((m for m in marks if m["kind"] == "line"), key=lambda m: len(m["path"]))
    offset, factor = 0.0, 1.0
    for text in texts(marks):
        if match := re.search(r"([+\N{MINUS SIGN}]) (\S+)$", text):
            offset = value(match[2]) * (1 if match[1] == "+" else -1)
        if match := re.match(r"\N{MULTIPLICATION SIGN} (10\S+)", text):
            factor = value(match[1])
    x, y = np.array(line["path"])[:, :2].T
    ticks = [m for m in marks if m["kind"] == "text" and m["align"] == "right" and m["text"] != "time"]
    pixels, numbers = np.array([(m["path"][0][1], value(m["text"])) for m in ticks]).T
    return np.stack(
        [
            np.polyval(axis(marks, 0, "center"), x),
            np.polyval(np.polyfit(pixels, numbers, 1), y) * factor + offset,
        ],
        -1,
    )


def test_the_plots_of_a_motion_are_those_of_the_trajectory(browser, address, small_atlas):
    """theta and psi' over time by the ticks, the path on the sphere by own projections, and the words above."""
    browser.open(address)
    browser.click(*pixel(browser, [5, 5]))
    browser.wait(DONE)
    place = {"sigma": float(small_atlas.sigma[5]), "theta0": float(small_atlas.theta0[5])}
    tr = small_atlas.atlas.trajectory(**place, samples=1001)
    said = browser.evaluate("document.getElementById('motion-state').textContent")
    count, step = re.fullmatch(r"30 time units, rk4, (\d+) steps of (\S+)", said).groups()
    assert float(count) * value(step) == pytest.approx(30, rel=1e-3)
    assert value(step) == pytest.approx(float(tr.step), rel=1e-3)
    captions = texts_of(browser, "#plots figcaption")
    assert captions[0].startswith("θ (rad) from ")
    assert captions[1].startswith("ψ̇ (rad s\N{MINUS SIGN}1) from ")
    for number, values in ((0, tr.theta.values), (1, tr.psi_dot.values)):
        low, high = (value(text) for text in re.search(r"from (\S+) to ([^\s,]+)", captions[number]).groups())
        size = float(np.abs(values).max())
        assert low == pytest.approx(float(values.min()), abs=2e-3 * size)
        assert high == pytest.approx(float(values.max()), abs=2e-3 * size)
        canvas = f"document.querySelectorAll('#plots canvas')[{number}]"
        marks = drawn(browser, canvas, "drawMotion(lastMotion)")
        drawn_curve = curve_of(marks)
        expected = np.interp(drawn_curve[:, 0], tr.time, values)
        np.testing.assert_allclose(drawn_curve[:, 1], expected, atol=0.02 * np.ptp(values))


@pytest.mark.long
def test_theta_of_a_motion_in_degrees(browser, small_atlas, tmp_path, quick_page):
    path = tmp_path / "degrees.html"
    atlas_page(small_atlas, degrees=True).save(path)
    browser.open(path.as_uri())
    browser.click(*pixel(browser, [5, 5]))
    browser.wait(DONE)
    theta = np.degrees(
        small_atlas.atlas.trajectory(
            sigma=float(small_atlas.sigma[5]), theta0=float(small_atlas.theta0[5])
        ).theta.values
    )
    said = re.fullmatch(r"θ \(deg\) from (\S+) to (\S+)", texts_of(browser, "#plots figcaption")[0])
    assert [value(text) for text in said.groups()] == pytest.approx([theta.min(), theta.max()], rel=1e-3)


def test_the_sphere_of_a_motion_is_seen_from_outside(browser, address, small_atlas):
    """Strong on the side of the reader, with the names of the frame where its axes point."""
    browser.open(address)
    browser.click(*pixel(browser, [5, 5]))
    browser.wait(DONE)
    place = {"sigma": float(small_atlas.sigma[5]), "theta0": float(small_atlas.theta0[5])}
    tr = small_atlas.atlas.trajectory(**place, samples=1001)
    canvas = "document.querySelector('#plots .turn')"
    marks = drawn(browser, canvas, "drawMotion(lastMotion)")
    accent, far, soft = browser.evaluate("['accent', 'far', 'soft'].map(colour)")
    middle = np.array(browser.evaluate(f"[{canvas}.clientWidth / 2, {canvas}.clientHeight / 2]"))
    azimuth, elevation = np.radians([40.0, 25.0])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    viewer = np.array(
        [*(np.cos(elevation) * np.array([np.cos(azimuth), np.sin(azimuth)])), np.sin(elevation)]
    )
    on_page = np.stack([right, -np.cross(viewer, right)], -1)  # downwards, as pixels count
    lines = {
        mark["ink"]: np.array(mark["path"])[:, :2] - middle
        for mark in marks
        if mark["kind"] == "line" and mark["path"]
    }
    radius = max(
        np.abs(np.array(m["path"])[:, 0] - middle[0]).max()
        for m in marks
        if m["kind"] == "line" and m["ink"] == soft and m["path"]
    )
    path = np.stack([tr.axis_x, tr.axis_y, tr.axis_z], -1)
    is_near = path @ viewer >= 0
    assert 0 < is_near.sum() < is_near.size
    for ink, mask in ((accent, is_near), (far, ~is_near)):
        expected = path[mask] @ on_page * radius
        distance = np.hypot(*(lines[ink][:, None] - expected).T)
        assert distance.min(0).max() < 2 + 0.05 * radius
        assert distance.min(1).max() < 2
    places = texts(marks)
    for name, direction in zip(("radius", "velocity", "normal"), np.eye(3), strict=True):
        away, tip = np.array(places[name]) - middle, direction @ on_page
        assert (away[1] > 0) == (tip[1] > 0)
        assert abs(tip[0]) < 0.3 or (away[0] > 0) == (tip[0] > 0)


def test_a_small_path_is_enlarged_with_up_at_the_top(browser, address, small_atlas):
    """Offsets of the axis: upward along minus theta', sideways along psi'."""
    browser.open(address)
    browser.evaluate(
        "document.getElementById('plots').replaceChildren(); document.getElementById('motion-section').hidden = false"
    )
    t = np.linspace(0, 2 * np.pi, 200)
    theta, psi = 1.0 - 2e-3 * np.sin(t) * (t < np.pi), 1e-3 * np.cos(t)
    path = np.stack([np.sin(psi) * np.sin(theta), -np.cos(psi) * np.sin(theta), np.cos(theta)], -1).tolist()
    marks = drawn(
        browser,
        "document.querySelector('#plots canvas')",
        f"addEnlarged(document.getElementById('plots'), {path})",
    )
    line = max((m for m in marks if m["kind"] == "line"), key=lambda m: len(m["path"]))
    x, y = np.array(line["path"])[:, :2].T
    assert np.argmin(y) == pytest.approx(np.argmin(theta), abs=2)  # the top of the canvas is y = 0
    assert np.corrcoef(x, psi * np.sin(theta))[0, 1] > 0.999
    assert np.corrcoef(-y, -theta)[0, 1] > 0.999
    assert "within" in texts_of(browser, "#plots figcaption")[0]


@pytest.mark.parametrize(
    ("number", "shown"),
    [
        ("0", "0"), ("-Infinity", "-\N{INFINITY}"), ("0.001", "0.001"), ("0.00012345", "1.2345 x 10⁻⁴"), ("-2.5e7", "-2.5 x 10⁷"),
        ("1e6", "10⁶"), ("123456.7", "123457"), ("-0.25", "-0.25"), ("null", "\N{EN DASH}"),
    ],
)  # fmt: skip
def test_numbers_for_readers(browser, address, number, shown):
    if browser.evaluate("typeof numberText") != "function":
        browser.open(address)
    shown = shown.replace("-", "\N{MINUS SIGN}").replace("x", "\N{MULTIPLICATION SIGN}")
    assert browser.evaluate(f"numberText({number})") == shown
