"""Pages used in a headless browser, as a reader uses them."""

import html
import importlib
import json
import re
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from plain_kernel import plain_module
from plugins import PENDULUM

import atlas
from atlas.extensions.page import motion, page
from atlas.extensions.page.page import atlas_page
from atlas.kernel import blocks
from atlas.kernel.ensemble import Ensemble
from atlas.label.trajectory import point_columns

ROOT = Path(__file__).parents[3]
DONE = "(document.getElementById('motion-section').dataset.done || '') !== ''"


def text(browser, name):
    """Text of the element with an id."""
    return browser.evaluate(f"document.getElementById('{name}').textContent")


def pixel(browser, index, context=None):
    """Place of a point on the screen, or in a frame by its context."""
    return browser.evaluate(
        f"(() => {{ const frame = marks.getBoundingClientRect(); const [x, y] = pixelOf({index});"
        " return [frame.left + x, frame.top + y]; })()",
        context,
    )


def painted(browser, canvas):
    """Number of different colours on a canvas."""
    return browser.evaluate(
        f"(() => {{ const c = {canvas}; const d = new Uint32Array(c.getContext('2d').getImageData(0, 0, c.width,"
        " c.height).data.buffer); return new Set(d).size; })()"
    )


@pytest.mark.long
def test_hover_shows_parameters_label_status_statistics_and_theory(browser, address, small_atlas):
    browser.open(address)
    assert text(browser, "place") == "Point at the map"
    assert painted(browser, "map") > 3
    browser.mouse("mouseMoved", *pixel(browser, [2, 3]))
    point = small_atlas.isel(sigma=2, theta0=3)
    assert text(browser, "place") == f"C/A = {float(point.sigma):.6g}, θ0 = {float(point.theta0):.6g}"
    meaning = point.label.attrs["flag_meanings"].split()[int(point.label)]
    assert meaning.replace("_", " ") in text(browser, "verdict")
    assert "integrated and resolved" in text(browser, "verdict")
    values = text(browser, "values")
    for part in ("predicted", "agreement", "growth rate", "error estimate", "k3"):
        assert part in values
    browser.mouse("mouseMoved", 5, 5)
    assert text(browser, "place") == "Point at the map"
    assert not browser.errors
    assert not browser.requests


def test_click_draws_the_motion_and_the_lines_to_copy(browser, address, small_atlas):
    browser.open(address)
    browser.click(*pixel(browser, [7, 2]))
    browser.wait(DONE)
    point = small_atlas.isel(sigma=7, theta0=2)
    tr = small_atlas.atlas.trajectory(sigma=float(point.sigma), theta0=float(point.theta0))
    assert f"{float(tr.time[-1]):g} time units, rk4" in text(browser, "motion-state")
    captions = browser.evaluate(
        "[...document.querySelectorAll('#plots figcaption')].map(each => each.textContent)"
    )
    low, high = map(float, re.findall(r"\d+\.\d+", captions[0]))
    np.testing.assert_allclose([low, high], [tr.theta.min(), tr.theta.max()], atol=2e-4)
    pictures = browser.evaluate("document.querySelectorAll('#plots canvas').length")
    assert pictures >= 3
    for i in range(pictures):
        assert painted(browser, f"document.querySelectorAll('#plots canvas')[{i}]") > 3
    lines = browser.evaluate(
        "[...document.querySelectorAll('#reproduce code')].map(each => each.textContent)"
    )
    sigma, theta0 = float(point.sigma), float(point.theta0)
    assert lines[0].startswith("atlas trajectory small.nc --at sigma=")
    assert [float(number) for number in re.findall(r"=([\d.e-]+)", lines[0])] == [sigma, theta0]
    (arguments,) = re.findall(r"trajectory\((.*)\)", lines[1])
    repeated = eval(f"small.atlas.trajectory({arguments})", {"small": small_atlas})
    assert repeated.identical(tr) or np.array_equal(repeated.theta, tr.theta)
    before = painted_bytes(browser, "document.querySelector('#plots .turn')")
    browser.evaluate("document.querySelector('#plots .turn').focus()")
    browser.press("ArrowLeft")
    assert painted_bytes(browser, "document.querySelector('#plots .turn')") != before
    assert not browser.errors
    assert not browser.requests


def painted_bytes(browser, canvas):
    """Picture on a canvas."""
    return browser.evaluate(f"{canvas}.toDataURL()")


def states_of(browser, index):
    """States at the samples of the motion that the page integrates."""
    return np.array(
        browser.evaluate(
            f"atlasPage.motionOf({list(index)}).then(m => m.states.filter((_, i) => i % m.perSample === 0))"
        )
    )


@pytest.mark.usual("index1")
@pytest.mark.parametrize("index", [(0, 0), (8, 6), (5, 1)])
def test_the_motion_has_the_bits_of_the_kernel_in_plain_python(browser, address, small_atlas, index):
    """The compiled kernel fuses products and sums, and differs by rounding alone."""
    browser.open(address)
    states = states_of(browser, index)
    place = {name: float(small_atlas[name][i]) for name, i in zip(("sigma", "theta0"), index, strict=True)}
    tr = small_atlas.atlas.trajectory(**place)
    system = atlas.systems.get("satellite")
    step = float(tr.step)
    steps = round(float(tr.time[1]) / step)
    parameters = {
        name: [float(tr.get(f"{name}_start", tr.get(name)))] for name in system.parameters if name in tr
    }
    points, _ = point_columns(system, parameters)
    ensemble = Ensemble.of(system, points)
    plain = plain_module(system.equations, "rk4")
    state = blocks.start_state(plain, ensemble.state)[:, 0].tolist()
    constants = ensemble.constants[:, 0].tolist()
    unit = step / plain.STEP
    for sample in range(1, 101):
        y, c = plain.scaled(state, constants, unit)
        for _ in range(steps):
            y = plain.step(y, plain.rhs(y, c), c)
        state = plain.unscaled(y, c, unit)
        assert np.array_equal(states[sample], state[: len(ensemble.state)])
    compiled = np.stack([tr[name].values for name in system.equations.STATE], -1)
    assert states.shape == compiled.shape
    np.testing.assert_allclose(states[:100], compiled[:100], rtol=0, atol=1e-13)


def test_keys_move_choose_and_zoom(browser, address):
    browser.open(address)
    browser.evaluate("marks.focus()")
    browser.press("ArrowRight")
    first = text(browser, "announcement")
    browser.press("ArrowRight")
    second = text(browser, "announcement")
    assert first != second
    assert "C/A = " in second
    assert "drifting" in second or "rotation" in second or "precession" in second
    browser.press("Enter")
    browser.wait(DONE)
    whole = browser.evaluate("state.view")
    browser.press("+")
    zoomed = browser.evaluate("state.view")
    assert zoomed[0][1] - zoomed[0][0] < 0.7 * (whole[0][1] - whole[0][0])
    browser.press("0")
    assert browser.evaluate("state.view") == whole
    x, y = pixel(browser, [4, 3])
    browser.mouse("mouseWheel", x, y, deltaX=0, deltaY=-200)
    browser.wait(f"state.view[0][0] > {whole[0][0]}")
    assert not browser.errors


@pytest.mark.long
def test_every_variable_can_be_drawn_in_light_and_dark(browser, address, small_atlas):
    browser.open(address, dark=True)
    assert browser.evaluate("document.documentElement.dataset.theme") == "dark"
    count = browser.evaluate("document.getElementById('variable').options.length")
    assert count == len(small_atlas.data_vars)
    browser.evaluate(
        f"for (let i = 0; i < {count}; i++) {{ const menu = document.getElementById('variable'); menu.value = String(i);"
        " menu.dispatchEvent(new Event('change')); }"
    )
    browser.evaluate("document.getElementById('theme').click()")
    assert browser.evaluate("document.documentElement.dataset.theme") == "light"
    assert not browser.errors


@pytest.mark.long
def test_the_address_leads_to_variable_and_point(browser, address, small_atlas):
    browser.open(address)
    browser.click(*pixel(browser, [7, 2]))
    browser.wait(DONE)
    sigma, theta0 = float(small_atlas.sigma[7]), float(small_atlas.theta0[2])
    hash_ = browser.evaluate("location.hash")
    assert dict(part.split("=") for part in hash_[1:].split("&")) == {
        "variable": "label", "sigma": repr(sigma), "theta0": repr(theta0),
    }  # fmt: skip
    browser.call("Page.navigate", url="about:blank")
    browser.open(f"{address}#variable=growth_rate&sigma={sigma + 0.01}&theta0={theta0}")
    browser.wait(DONE)
    assert browser.evaluate("document.getElementById('motion-section').dataset.done") == "7,2"
    assert browser.evaluate("state.variable.name") == "growth_rate"
    assert not browser.errors


def test_the_motion_plays_on_the_sphere(browser, address):
    browser.open(address)
    browser.click(*pixel(browser, [5, 1]))
    browser.wait(DONE)
    still = painted_bytes(browser, "document.querySelector('#plots .turn')")
    browser.evaluate("document.querySelector('.play').click()")
    browser.wait(f"document.querySelector('#plots .turn').toDataURL() !== {still!r}")
    assert "pause" in browser.evaluate("document.querySelector('.play').textContent")
    browser.evaluate("document.querySelector('.play').click()")
    assert "play" in browser.evaluate("document.querySelector('.play').textContent")
    assert not browser.errors


def test_errors_above_1_are_explained(browser, address, small_atlas):
    browser.open(address)
    above = (small_atlas.error_estimate > 1).transpose("sigma", "theta0").values
    assert above.any()
    assert not above.all()
    for index in (np.argwhere(above)[0], np.argwhere(~above)[0]):
        browser.evaluate(f"showPoint({index.tolist()})")
        assert ("Error estimate above 1: an instability" in text(browser, "verdict")) == above[tuple(index)]


def test_a_print_has_no_buttons(browser, address):
    browser.open(address)
    browser.call("Emulation.setEmulatedMedia", media="print")
    shown = "(name) => getComputedStyle(document.querySelector(name)).display !== 'none'"
    try:
        assert not any(
            browser.evaluate(f"({shown})('{name}')") for name in ("button", "#keys", "#point-section")
        )
        assert browser.evaluate(f"({shown})('#variable')")
    finally:
        browser.call("Emulation.setEmulatedMedia", media="")


def test_phone(browser, address):
    browser.open(address, 390, 800, mobile=True)
    assert browser.evaluate("document.documentElement.scrollWidth") <= 390
    x, y = pixel(browser, [1, 5])
    for kind, points in (("touchStart", [{"x": x, "y": y}]), ("touchEnd", [])):
        browser.call("Input.dispatchTouchEvent", type=kind, touchPoints=points)
    browser.wait(DONE)
    assert browser.evaluate("document.documentElement.scrollWidth") <= 390
    assert not browser.errors
    heights = "[...document.querySelectorAll('select, button, summary')].map((each) => each.getBoundingClientRect().height)"
    shown = [height for height in browser.evaluate(heights) if height]
    assert len(shown) > 5
    assert min(shown) >= 44  # px: as wide as a finger


def test_a_wide_window_is_used_after_a_click(browser, address):
    browser.open(address, 2400, 1000)
    browser.click(*pixel(browser, [5, 1]))
    browser.wait(DONE)
    box = "document.querySelector('{}').getBoundingClientRect().{}"
    motion, values = (browser.evaluate(box.format(each, "left")) for each in ("#motion-section", "#values"))
    assert values > motion + 400  # beside each other
    right = max(browser.evaluate(box.format(each, "right")) for each in ("#motion-section", "#values"))
    assert right > 2300
    assert browser.evaluate("document.documentElement.scrollHeight") < 2000


def test_a_slider_for_a_further_axis(browser, cube_atlas, tmp_path, quick_page):
    path = tmp_path / "cube.html"
    cube_atlas.atlas.page().save(path)
    browser.open(path.as_uri())
    labels = "cells().colours.join()"
    # The slider begins in the middle of its two values, at the second one.
    before = browser.evaluate(labels)
    browser.evaluate(
        "(() => { const slider = document.querySelector('#sliders input'); slider.value = '0';"
        " slider.dispatchEvent(new Event('input')); })()"
    )
    assert "m = \N{MINUS SIGN}0.5" in text(browser, "sliders")
    differ = bool((cube_atlas.label.isel(m=0) != cube_atlas.label.isel(m=1)).any())
    assert (browser.evaluate(labels) != before) == differ
    browser.click(*pixel(browser, [3, 3, 0]))
    browser.wait(DONE)
    assert "m=-0.5" in text(browser, "reproduce")
    assert "Lines of theory are left out" in text(browser, "notes")
    assert not browser.errors


@pytest.mark.long
def test_single_points_and_their_axes(browser, sampled_atlas, tmp_path, quick_page):
    path = tmp_path / "sampled.html"
    sampled_atlas.atlas.page().save(path)
    browser.open(path.as_uri())
    browser.click(*pixel(browser, [17]))
    browser.wait(DONE)
    assert "trajectory(point=17)" in text(browser, "reproduce")
    assert len(states_of(browser, [17])) == motion.SAMPLES
    browser.evaluate(
        "(() => { const menu = document.querySelector('#places select'); menu.value = '3';"
        " menu.dispatchEvent(new Event('change')); })()"
    )
    assert painted(browser, "map") > 3
    assert not browser.errors


def test_a_map_over_one_axis(browser, small_atlas, tmp_path, quick_page):
    path = tmp_path / "line.html"
    small_atlas.isel(theta0=2).atlas.page().save(path)
    browser.open(path.as_uri())
    assert painted(browser, "map") > 3
    browser.evaluate(
        "(() => { const menu = document.getElementById('variable'); menu.value = [...menu.options].find(each =>"
        " each.textContent.startsWith('growth')).value; menu.dispatchEvent(new Event('change')); })()"
    )
    browser.click(*pixel(browser, [4]))
    browser.wait(DONE)
    assert not browser.errors


@pytest.mark.long
def test_a_system_with_observables(browser, tmp_path, monkeypatch, quick_page, own_systems):
    """A pendulum of another module: its angle and height over time, with the steps that the atlas recorded."""
    (tmp_path / "pendulum_of_a_page.py").write_text(PENDULUM)
    monkeypatch.syspath_prepend(tmp_path)
    atlas.register(importlib.import_module("pendulum_of_a_page").Pendulum)
    points = {"omega": np.array([0.5, 1.0, 1.5]), "x0": np.array([0.5, 1.5, 2.5]), "cubic": 0.3}
    ds = atlas.label_points("pendulum", points, duration=20.0, tolerance=1e-6, method="rk8")
    ds.atlas.page().save(tmp_path / "pendulum.html")
    browser.open((tmp_path / "pendulum.html").as_uri())
    browser.click(*pixel(browser, [1]))
    browser.wait(DONE)
    captions = browser.evaluate(
        "[...document.querySelectorAll('#plots figcaption')].map(each => each.textContent)"
    )
    assert [caption.split()[0] for caption in captions] == ["x", "height"]
    for i in range(3):
        tr = ds.atlas.trajectory(omega=float(ds.omega[i]), x0=float(ds.x0[i]))
        assert float(tr.step) == browser.evaluate(f"startOf([{i}]).stepSize")
        np.testing.assert_allclose(states_of(browser, [i]), np.stack([tr.x, tr.v], -1), rtol=0, atol=1e-11)
    assert not browser.errors


HOSTILE = "</script><script>hacked=1</script><img src=x onerror=hacked=2>{{data}}<!--&quot;"


def test_texts_of_a_stranger_are_texts(browser, small_atlas, tmp_path):
    ds = small_atlas.copy()
    ds.attrs |= {"title": HOSTILE, "references": HOSTILE}
    ds["sigma"].attrs |= {"long_name": HOSTILE, "units": HOSTILE}
    ds["theta0"].attrs["long_name"] = r"$\unknown{\dot\theta$"
    ds[HOSTILE] = ds["theta_min"].assign_attrs(long_name=HOSTILE, units=HOSTILE, comment=HOSTILE)
    flags = " ".join(f"<b>{i}</b>\"'" for i in range(5))
    ds["__proto__"] = ds["label"].assign_attrs(flag_meanings=flags, flag_values=np.arange(5, dtype=np.int8))
    page = atlas_page(ds, file="a b'; rm -rf ~ #.nc")
    path = tmp_path / "hostile.html"
    page.save(path)
    assert page.html.count("<script") == 2
    browser.open(path.as_uri())
    assert browser.evaluate("document.title") == HOSTILE
    assert browser.evaluate("document.querySelector('h1').textContent") == HOSTILE
    browser.evaluate(
        "[...document.getElementById('variable').options].forEach(each => { const menu ="
        " document.getElementById('variable'); menu.value = each.value; menu.dispatchEvent(new Event('change')); })"
    )
    browser.click(*pixel(browser, [4, 4]))
    browser.wait(DONE)
    assert browser.evaluate("typeof hacked") == "undefined"
    assert browser.evaluate("document.querySelectorAll('img, iframe, main b').length") == 0
    assert """atlas trajectory 'a b'"'"'; rm -rf ~ #.nc' --at""" in text(browser, "reproduce")
    assert not browser.errors
    assert not browser.requests


def test_the_policy_forbids_other_scripts_and_the_network(browser, address):
    browser.open(address)
    browser.evaluate(
        "document.body.append(Object.assign(document.createElement('script'), {textContent: 'window.hacked = 1'}))"
    )
    assert browser.evaluate("typeof hacked") == "undefined"
    refused = browser.evaluate("fetch('https://example.org/').then(() => 'sent', () => 'refused')")
    assert refused == "refused"
    assert browser.errors  # of the policy


def test_in_a_notebook(browser, small_page, tmp_path):
    """The frame may run its script, and reaches nothing outside."""
    path = tmp_path / "notebook.html"
    frame = small_page._repr_html_()
    path.write_text(
        f"<!DOCTYPE html><html data-ready='yes'><meta charset='utf-8'><body>{frame}</body></html>"
    )
    assert html.escape("<script") in frame
    browser.open(path.as_uri(), 1000, 900)
    assert (
        browser.evaluate("document.querySelector('iframe').sandbox.value") == "allow-scripts allow-downloads"
    )
    browser.wait("document.documentElement?.dataset.ready === 'yes'", context=browser.contexts[-1])
    assert (
        browser.evaluate("document.querySelector('h1').textContent", context=browser.contexts[-1]) == "small"
    )
    assert not browser.errors
    assert not browser.requests


@pytest.mark.long
def test_scripts_that_need_a_browser_run(browser, small_scene, quick_page, tmp_path, monkeypatch, capsys):
    (tmp_path / "small.toml").write_text(small_scene)
    file, picture = str(tmp_path / "small.nc"), tmp_path / "page.png"
    atlas.run(tmp_path / "small.toml", file, progress=False).close()
    for folder, name, arguments in (
        ("benchmarks", "bench_page", ()),
        ("tools", "draw_page", (str(picture),)),
    ):
        monkeypatch.syspath_prepend(ROOT / "scripts" / folder)
        script = importlib.import_module(name)
        monkeypatch.setattr(script.browser, "launched", lambda: nullcontext(browser))
        monkeypatch.setattr("sys.argv", [name, file, *arguments])
        script.main()
    assert re.search(r"^\| small \| 9 x 7 \| \d+ \|", capsys.readouterr().out, re.M)
    assert picture.stat().st_size > 10_000


@pytest.fixture
def widget_page(browser, small_page, tmp_path):
    """The widget in a page, with the model of a notebook, of which it uses get, set and save_changes; and its frame."""
    script = json.dumps((Path(page.__file__).parent / "widget.js").read_text())
    texts = json.dumps({"frame": small_page._repr_html_()}).replace("<", "\\u003c")
    path = tmp_path / "widget.html"
    path.write_text(
        "<!DOCTYPE html><html><meta charset='utf-8'><body><div id='cell'></div><script type='module'>\n"
        f"const values = {texts};\nwindow.saved = [];\n"
        "const model = { get: (name) => values[name], set: (name, value) => { values[name] = value; },"
        " save_changes: () => saved.push({ ...values.point }) };\n"
        f"const module = await import(URL.createObjectURL(new Blob([{script}], {{ type: 'text/javascript' }})));\n"
        "window.remove = module.default.render({ model, el: document.getElementById('cell') });\n"
        "await new Promise((done) => document.querySelector('iframe').addEventListener('load', done));\n"
        "document.documentElement.dataset.ready = 'yes';\n</script></body></html>"
    )
    browser.open(path.as_uri(), 1000, 950)
    frame = browser.contexts[-1]
    browser.wait("document.documentElement?.dataset.ready === 'yes'", context=frame)
    return frame


@pytest.mark.long
def test_a_click_in_the_widget_reaches_python(browser, widget_page, small_atlas):
    """What the widget saves is the point, exactly, and nothing else may send one."""
    left, top = browser.evaluate(
        "(() => { const box = document.querySelector('iframe').getBoundingClientRect(); return [box.left, box.top]; })()"
    )
    x, y = pixel(browser, [2, 3], widget_page)
    browser.click(left + x, top + y)
    browser.wait("saved.length === 1")
    browser.evaluate("postMessage({ point: { sigma: 1 } }, '*')")
    browser.evaluate("new Promise((done) => setTimeout(done, 50))")
    ((saved,),) = [browser.evaluate("saved")]
    widget = small_atlas.atlas.widget()
    seen = []
    widget.observe(lambda change: seen.append(change["new"]), "point")
    widget.set_state({"point": saved})  # as the notebook does
    assert seen == [saved]
    point = small_atlas.sel(widget.point)
    assert point.sigma.shape == point.theta0.shape == ()
    assert dict(widget.point) == {
        name: float(small_atlas.isel(sigma=2, theta0=3)[name]) for name in point.coords if name in saved
    }
    assert small_atlas.atlas.trajectory(**widget.point).sizes["time"] > 1
    browser.evaluate("remove()")
    assert not browser.errors
    assert not browser.requests


def test_the_picture_of_the_view_holds_map_and_legend(browser, address):
    browser.open(address)
    browser.evaluate(
        "window.pictures = []; URL.createObjectURL = (blob) => { pictures.push(blob); return '#'; };"
        " HTMLAnchorElement.prototype.click = function () { pictures.push(this.download); }"
    )
    map_width, map_height = browser.evaluate(
        "(() => { byId('save-picture').click(); return [map.width, map.height]; })()"
    )
    browser.wait("pictures.length === 2")
    name, kind, width, height = browser.evaluate(
        "(async () => { const [blob, name] = pictures; const { width, height } = await createImageBitmap(blob);"
        " return [name, blob.type, width, height]; })()"
    )
    assert (name, kind) == ("label.png", "image/png")
    assert width == map_width
    assert height > map_height + 20
    assert not browser.errors
