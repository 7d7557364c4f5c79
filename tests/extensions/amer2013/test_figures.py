"""The example amer2013_figures: quantities and rotors of its figures are those of the captions, curves those of the equations."""

import re
import tomllib
from importlib import resources
from string import Formatter

import numpy as np
import pytest
from amer2013_figures import claims
from amer2013_figures import figures as amer2013
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from refusals import assert_refused_in_shell
from scipy.interpolate import make_interp_spline

from atlas.cli import main, parser
from atlas.errors import BadInput
from atlas.extensions.amer2013 import fast_spin

# The captions of the paper: number -> quantity, phase plane, |l| / sqrt(3), for A = B < C, analytical.
CAPTIONS = {
    1: ("p2", False, (0, 10, 20)),
    2: ("p2", False, (30, 40, 50)),
    3: ("gamma2", False, (30, 40, 50)),
    4: ("p2", True, (50,)),
    5: ("gamma2", True, (10,)),
}


@pytest.mark.parametrize("number", amer2013.NUMBERS)
def test_every_figure_has_the_quantity_of_its_caption(number):
    figure = amer2013.paper_figure(number)
    quantity, phase_plane, rotors = CAPTIONS[(number - 1) % 5 + 1]
    assert (figure.quantity, figure.phase_plane, figure.rotors) == (quantity, phase_plane, rotors)
    assert figure.body == ("A > C" if number in (*range(6, 11), *range(16, 21)) else "A < C")
    assert figure.numerical == (number > 10)
    assert quantity in figure.caption
    assert f"A = B {figure.body[2:]}" in figure.caption


@pytest.mark.usual("12")
@pytest.mark.parametrize("number", [2, 7, 12, 17])
def test_curves_are_those_of_the_equations(number):
    """The true curves against the full equations by DOP853; the printed ones are far from them."""
    figure = amer2013.paper_figure(number)
    tau = np.linspace(0, amer2013.END, 1001)
    motion = amer2013.curves(figure, tau)
    for i, rotor in enumerate(figure.rotors):
        spin = fast_spin.paper_body(figure.body, rotor)
        y0 = fast_spin.paper_start(spin)
        exact = fast_spin.to_quasilinear(spin, fast_spin.integrate(spin, y0, tau))
        size = np.ptp(exact[0])
        start = float(spin.C * spin.A1 * spin.y[0] / spin.A)
        for source, path in motion.items():
            if "(33)" not in source and source != "periodic":  # these have other starts
                np.testing.assert_allclose(path[:2, 0, i], [start, 0], atol=1e-6 * size)
        np.testing.assert_allclose(motion["(1)"][..., i], exact, atol=1e-8 * size)
        # the exact periodic solution returns, and its p2 rests where the exact motion has its centre
        periodic = motion["periodic"][..., i]
        assert np.ptp(periodic[0]) < 1e-5 * size
        assert periodic[0, 0] == pytest.approx(0.5 * (exact[0].max() + exact[0].min()), rel=1e-4)
        np.testing.assert_allclose(periodic[2:, 500], periodic[2:, 0], atol=1e-3)
        if figure.numerical:
            assert np.abs(motion["(15), true"][0, :, i] - exact[0]).max() < 1e-4 * size
            # only the sign in omega'^2 is wrong
            assert 1e-3 < np.abs(motion["(15), printed"][0, :, i] - exact[0]).max() / size < 5e-2
        else:
            assert np.abs(motion["general"][0, :, i] - exact[0]).max() < 1e-4 * size
            assert np.abs(motion["general"][2, :, i] - exact[2]).max() < 1e-3
            assert np.ptp(motion["(33), true"][0, :, i]) < 1e-9 * size
            centre = 0.5 * (exact[0].max() + exact[0].min())
            assert motion["(33), true"][0, 0, i] == pytest.approx(centre, rel=1e-4)
            assert np.abs(motion["(33), printed"][0, :, i]).max() < 1e-6
            assert np.abs(motion["(20), printed"][0, :, i] - exact[0]).max() > 0.5 * size


@pytest.mark.usual("9-3")
@pytest.mark.parametrize(("number", "panels"), [(1, 3), (3, 6), (9, 3), (20, 4)])
def test_figures_are_drawn(number, panels):
    drawn = amer2013.draw(number)
    assert drawn.get_figwidth() == pytest.approx(180 / 25.4)
    assert len(drawn.axes) == panels
    drawn.canvas.draw()
    for ax in drawn.axes:
        assert np.isfinite(np.concatenate([line.get_ydata() for line in ax.lines])).all()


@pytest.mark.long
@pytest.mark.parametrize("number", [2, 3, 8, 13, 18])
def test_no_curve_hides_another(number):
    """Every rotor has its colour in every panel that shows it, also where its curve coincides with others."""
    drawn = amer2013.draw(number)
    canvas = FigureCanvasAgg(drawn)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[..., :3] / 255.0
    for ax in drawn.axes:
        box = ax.get_window_extent()
        rows = slice(round(pixels.shape[0] - box.y1), round(pixels.shape[0] - box.y0))
        panel = pixels[rows, round(box.x0) : round(box.x1)]
        for colour in amer2013.LINES[:3]:
            # the colour or a mixture of it with white, as the edge of a line has
            away = np.array(to_rgb(colour)) - 1
            share = (panel - 1) @ away / (away @ away)
            same = np.abs(panel - 1 - share[..., None] * away).max(-1) < 0.03
            assert (same & (share > 0.3)).sum() > 50


@pytest.mark.usual("4")
@pytest.mark.parametrize("number", [4, 5])
def test_the_legend_has_every_source_as_it_is_drawn(number):
    """Dashed, or a cross where a solution rests in the phase plane."""
    printed, corrected, exact = amer2013.draw(number).axes[-3:]
    at_rest = "+" if number == 4 else "None"
    for ax, second, names in (
        (printed, "+", ["(20)", "(33)"]),
        (corrected, at_rest, ["from (18)", "(33)"]),
        (exact, at_rest, ["(1) from (18)", "periodic"]),
    ):
        assert [text.get_text() for text in ax.get_legend().get_texts()] == names
        entries = ax.get_legend().get_lines()
        for i, entry in enumerate(entries):
            assert entry.get_marker() == ax.lines[i].get_marker()
            assert entry.get_linestyle() == ax.lines[i].get_linestyle()
        assert entries[1].get_marker() == second


# Heading of a column of panels -> entry of its legend -> solution by the equations alone, None where it starts elsewhere.
SOLUTIONS = {
    "exact": ["(1) from (18)", "periodic"],
    "first order, corrected": {False: ["from (18)", "(33)"], True: ["(15)"]},
    "as printed": {False: ["(20)", "(33)"], True: ["(15)"]},
}


def rotor_of(line, figure):
    """The rotor that the legend of a figure gives to the colour of a curve, which may be mixed with white."""
    legend, colour = figure.legends[0], np.array(to_rgb(line.get_color()))
    for text, sample in zip(legend.get_texts(), legend.get_lines(), strict=True):
        away = np.array(to_rgb(sample.get_color())) - 1
        share = (colour - 1) @ away / (away @ away)
        if np.abs(colour - 1 - share * away).max() < 1e-6:
            number = re.search(r"= ([\d.]+)", text.get_text())[1]
            return float(number)
    raise AssertionError("no entry of this colour")


@pytest.mark.usual("2")
@pytest.mark.parametrize("number", [2, 3, 6, 13])
def test_every_curve_is_that_of_its_rotor_column_and_axis(number):
    """Over tau: the exact motion by DOP853, the corrected one near it and the printed one not."""
    figure, drawn = amer2013.paper_figure(number), amer2013.draw(number)
    row = {"p2": 0, "gamma2": 2}[figure.quantity]
    top = drawn.axes[:3]
    assert top[0].get_ylabel().startswith({"p2": "$p_2$ (units", "gamma2": r"$\gamma_2$"}[figure.quantity])
    assert drawn.axes[-3].get_xlabel() == r"$\tau = r_0 t$"
    labels = drawn.axes[-3].get_xticklabels()
    ticks = dict(zip(drawn.axes[-3].get_xticks() / np.pi, [t.get_text() for t in labels], strict=True))
    assert ticks == {0: "0", 1: r"$\pi$", 2: r"$2\pi$", 3: r"$3\pi$", 4: r"$4\pi$"}
    assert drawn.get_suptitle() == f"Fig. {number}: $A = B {figure.body[2:]}$"
    far, seen = {}, set()
    for ax in top:
        legend = ax.get_legend()
        title, names = legend.get_title().get_text(), [text.get_text() for text in legend.get_texts()]
        expected = SOLUTIONS[title]
        assert names == (expected if isinstance(expected, list) else expected[figure.numerical])
        widths = {line.get_linewidth(): name for line, name in zip(legend.get_lines(), names, strict=True)}
        for line in ax.lines:
            rotor, name = rotor_of(line, drawn), widths[line.get_linewidth()]
            seen.add((title, name, rotor))
            if name == "periodic" or (name == "(33)" and title != "as printed"):
                continue  # these have other starts
            spin = fast_spin.paper_body(figure.body, rotor)
            tau, value = line.get_xydata()[::100].T
            path = fast_spin.integrate(spin, fast_spin.paper_start(spin), tau)
            path = fast_spin.to_quasilinear(spin, path)[row]
            size = np.ptp(path) if rotor else 1.0  # without a rotor p2 rests at 0
            far.setdefault(title, []).append(np.abs(value - path).max() / size)
    assert max(far["exact"]) < 1e-6
    assert max(far["first order, corrected"]) < (1e-3 if figure.quantity == "p2" else 2e-3)
    if figure.quantity == "p2":
        assert min(value for value in far["as printed"] if value > 1e-9) > 1e-2
    count = sum(
        len(each if isinstance(each, list) else each[figure.numerical]) for each in SOLUTIONS.values()
    )
    assert len(seen) == count * len(figure.rotors)
    if figure.quantity == "gamma2":
        assert drawn.axes[3].get_ylabel() == r"$\gamma_2 - M_3 \cos\tau$"
        for above, below in zip(top[2].lines, drawn.axes[5].lines, strict=True):
            harmonic = figure.M3 * np.cos(above.get_xdata())
            np.testing.assert_allclose(below.get_ydata(), above.get_ydata() - harmonic, atol=1e-12)


def test_the_axes_of_a_phase_plane_are_value_and_derivative():
    figure, drawn = amer2013.paper_figure(4), amer2013.draw(4)
    ax = drawn.axes[2]
    assert ax.get_xlabel().startswith("$p_2$ (units")
    assert drawn.axes[0].get_ylabel().startswith(r"$\dot p_2$ (units")
    (rotor,) = figure.rotors
    spin = fast_spin.paper_body(figure.body, rotor)
    tau = np.linspace(0, amer2013.END, amer2013.TIMES)
    path = fast_spin.integrate(spin, fast_spin.paper_start(spin), tau)
    expected = fast_spin.to_quasilinear(spin, path)[:2].T
    np.testing.assert_allclose(ax.lines[0].get_xydata(), expected, atol=1e-6 * np.ptp(expected))


def test_derivatives_of_the_printed_solution():
    """Of (33) as printed: against a spline through it."""
    figure, tau = amer2013.paper_figure(3), np.linspace(0, amer2013.END, 4001)
    path = amer2013.curves(figure, tau)["(33), printed"]
    spline = make_interp_spline(tau, path[2], k=7)
    np.testing.assert_allclose(path[3], spline(tau, 1), atol=1e-8)


def test_figure_table_agrees_with_the_full_equations():
    rows = claims.figure_table((0.0, 10.0, 50.0))
    assert [(row.body, row.rotor) for row in rows] == [
        (b, l) for b in ("A < C", "A > C") for l in (0.0, 10.0, 50.0)
    ]
    for row in rows:
        if row.rotor:
            assert row.centre == pytest.approx(row.centre_theory, rel=1e-6)
            assert row.amplitude == pytest.approx(row.amplitude_theory, rel=1e-6)
            assert row.period == pytest.approx(row.period_theory, rel=2e-5)
            assert abs(row.period - row.period_printed) > 50 * abs(row.period - row.period_theory)
    np.testing.assert_allclose(
        [(r.start, r.centre, r.amplitude, r.period, r.largest) for r in rows if r.rotor == 50],
        [(2747.62, 8055.20, 5307.59, 10.7378, 13362.79), (-686.12, -6086.47, 5400.35, 18.7415, 11486.82)],
        rtol=2e-5,
    )
    resting = [row for row in rows if not row.rotor]
    assert all(row.amplitude == 0 and row.gamma2_change < 1e-10 for row in resting)


@pytest.mark.long
def test_the_claims_of_the_paper_have_their_verdicts():
    rows = claims.figure_table((0.0, 10.0, 50.0))
    judged = claims.claims(rows)
    assert [claim.verdict for claim in judged] == [
        "holds",
        "does not hold",
        "holds",
        "holds to lowest order only",
        "does not hold",
        "holds for gamma2 only",
        "does not hold",
        "does not hold",
        "holds to lowest order, but not for the period",
        "does not hold",
        "holds for p2 only",
    ]
    assert [claim.holds for claim in judged] == [c.verdict == "holds" for c in judged]
    assert "1066.43, 5307.59" in judged[0].measured
    assert "the opposite sign" in judged[2].measured
    assert "0.00368" in judged[3].measured
    assert "(33) drops p2 as well" in judged[4].measured
    assert "|p2| < 1e-10" in judged[4].measured
    assert "exact periodic solution is stable with the paper's data" in judged[6].measured
    assert "rho + 1/rho = 2.201" in judged[6].measured
    assert "1.37 |mu/Omega| at most as printed, < 1e-9" in judged[9].measured


@pytest.mark.long
def test_every_claim_has_a_measure_all_of_whose_values_are_in_its_text():
    text = resources.files(claims.__package__).joinpath("claims.toml").read_text("utf-8")
    entries, rows = tomllib.loads(text), claims.figure_table((0.0, 20.0))
    assert entries.keys() == claims.MEASURES.keys()
    for name, measure in claims.MEASURES.items():
        names = {
            re.match(r"\w+", field)[0]
            for _, field, *_ in Formatter().parse(entries[name]["measured"])
            if field
        }
        assert measure(rows)[1].keys() == names, name


@pytest.mark.usual("A < C")
@pytest.mark.parametrize("body", fast_spin.PAPER_BODIES)
def test_gamma2_deviates_in_proportion_to_the_rotor(body):
    changes = [row.gamma2_change for row in claims.figure_table((10.0, 20.0, 50.0)) if row.body == body]
    np.testing.assert_allclose(np.array(changes) / changes[0], [1, 2, 5], rtol=0.02)


@pytest.mark.long
def test_the_upright_body_of_the_phase_plane_claim_is_unstable():
    """Growth of a small tilt in the full equations, at the r0 of the claim."""
    text = claims.claims(claims.figure_table((0.0, 10.0)))[6].measured
    r0 = float(text.split("r0 = ")[1].split()[0])
    growth = float(text.split("growth rate ")[1].split()[0])
    d = fast_spin.PAPER_DATA
    weight = -d["M"] * d["lambda"] / d["R"] ** 2 * d["z0"]
    spin = fast_spin.FastSpin(
        22.49, 35.6, weight, 3 * d["lambda"] / d["R"] ** 3, 0.0, 0.0, 0.0, r0, d["gamma0"]
    )
    tau = np.linspace(0, 12, 61)
    y = fast_spin.integrate(spin, np.array([1e-10, 0, 1, 1e-10, 0, 1 / d["gamma0"]]), tau)
    rate = np.polyfit(tau[30:], np.log(np.hypot(y[3], y[4]))[30:], 1)[0]
    assert rate == pytest.approx(growth, rel=0.02)
    spun = fast_spin.FastSpin(22.49, 35.6, weight, spin.N, 0.0, 0.0, 0.0, 3 * r0, d["gamma0"])
    y = fast_spin.integrate(spun, np.array([1e-10, 0, 1, 1e-10, 0, 1 / d["gamma0"]]), tau)
    assert np.hypot(y[3], y[4]).max() < 1e-8


def test_the_table_has_six_digits():
    rows = amer2013.amplitude_table(claims.figure_table((0.0, 40.0)))
    assert len({len(row) for row in rows}) == 1
    heading, still, moving, *_ = rows
    assert still[heading.index("period")] == "-"
    assert moving[heading.index("max |p2|")] == "10700.0"
    assert moving[heading.index("amplitude")] == "4250.97"
    assert still[heading.index("max |gamma2 - M3 cos tau|")] == "< 1e-10"


def test_the_columns_of_the_table_are_those_of_their_names():
    rows = claims.figure_table((30.0,))
    heading, *lines = amer2013.amplitude_table(rows)
    names = {
        "p2(0), (18)": "start", "centre": "centre", "amplitude": "amplitude", "period": "period", "waves in 4 pi": "waves",
        "max |p2|": "largest", "mu1/Omega": "centre_theory", "2 pi/Omega": "period_theory",
        "centre, (15) printed": "centre_printed", "amplitude, (15) printed": "amplitude_printed",
        "period, (15) printed": "period_printed", "amplitude of gamma2": "gamma2_amplitude", "period of gamma2": "gamma2_period",
        "max |gamma2 - M3 cos tau|": "gamma2_change", "unit of p2, rad/s": "unit",
    }  # fmt: skip
    for row, line in zip(rows, lines, strict=True):
        texts = dict(zip(heading, line, strict=True))
        assert (texts.pop("body"), float(texts.pop("l1 = l2 = l3"))) == (row.body, row.rotor)
        assert texts.keys() == names.keys()
        for name, text in texts.items():
            assert float(text) == pytest.approx(getattr(row, names[name]), rel=5e-3), name


@pytest.mark.long
def test_the_table_of_periodic_solutions_has_three_readings():
    rows = claims.periodic_table((0.0, 50.0))
    heading, *lines = amer2013.periodic_solutions(rows)
    assert {len(line) for line in lines} == {len(heading)} == {13}
    for row in rows:
        printed, first, exact = row.p1, row.period, row.trace
        assert row.stable_printed
        assert row.stability == "stable"
        if row.rotor:
            assert abs(printed[0]) < 1e-3 < abs(printed[1])
            assert printed[1] == pytest.approx(printed[2], rel=1e-6)
            assert first[1] == pytest.approx(first[2], rel=1e-4)
            assert abs(first[0]) > 100 * abs(first[2])
            assert abs(exact[1] - exact[2]) < 1e-4 < abs(exact[0] - exact[2])
            assert row.defect[0] > 0.5
            assert row.defect[1:].max() < 1e-9
    assert lines[1][heading.index("p1(0), exact")] == "8055.20"
    assert lines[1][-2:] == ("yes", "stable")


@pytest.fixture
def installed(install_example):
    install_example("amer2013_figures")


@pytest.mark.long
@pytest.mark.usefixtures("installed")
def test_the_command_writes_figures_and_the_table(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["amer2013_figures", "--only", "4", "--format", "svg"]) == 0
    assert (tmp_path / "figures" / "figure_04.svg").read_bytes().startswith(b"<?xml")
    assert "phase plane of the analytical solution p2 for l = 50 sqrt(3) N m s, A = B < C" in (
        capsys.readouterr().out
    )
    assert main(["amer2013_figures", "--table"]) == 0
    printed = capsys.readouterr().out
    assert "does not hold: A > C: the amplitude of p2 decreases" in printed
    assert "5307.59" in printed


@pytest.mark.usefixtures("installed")
@pytest.mark.parametrize(
    ("command", "sentence"),
    [
        ("amer2013_figures --only 4 --format svg", "figures: these files exist; --force replaces them: figure_04.svg"),
        ("amer2013_figures -o . --only 1 --format png", ".: these files exist; --force replaces them: figure_01.png"),
        ("amer2013_figures --only 21", "figure 21: the paper has figures 1 to 20"),
        ("amer2013_figures --only 1 2 x", "unrecognized arguments: x (see atlas --help)"),
        ("amer2013_figures --format png --format gif", "atlas amer2013_figures: argument --format: 'gif': allowed: png, pdf, svg (see ...)"),
        ("amer2013_figures -o figure.png", "figure.png: ...must be a folder..."),
        ("amer2013_figures -o taken", "taken: not a folder"),
    ],
)  # fmt: skip
def test_a_mistake_in_the_command(command, sentence, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "figures").mkdir()
    for name in ("figures/figure_04.svg", "figure_01.png", "taken"):
        (tmp_path / name).write_text("kept")
    assert_refused_in_shell(command, sentence, capsys)


@pytest.mark.usefixtures("installed")
def test_options_take_several_values_or_are_repeated():
    def values(*arguments):
        return vars(parser().parse_args(["amer2013_figures", *arguments]))

    assert values("--only", "1", "2", "--only", "3")["only"] == [1, 2, 3]
    assert values("--format", "png", "--format", "svg", "pdf")["format"] == ["png", "svg", "pdf"]


def test_the_paper_has_no_other_figures():
    with pytest.raises(BadInput, match="figure 0: the paper has"):
        amer2013.draw(0)
