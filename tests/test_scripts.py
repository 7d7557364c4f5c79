"""Every script of scripts/benchmarks and scripts/tools runs, here with small arguments."""

import logging
import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import pytest
from numba import njit

from atlas import cli

ROOT = Path(__file__).parent.parent
FOLDERS = [ROOT / "scripts" / "benchmarks", ROOT / "scripts" / "tools"]
SMALL = ROOT / "tests" / "small.toml"
# Arguments, in which FOLDER is an empty folder, and what the script then prints.
SCRIPTS = {
    "bench_any_axis": ("--points 2 --rounds 1 --systems fixed_point --methods rk8", r"the same to the bit"),
    "bench_catalogue": ("--points 30", r"together .*(?s:.*)multipliers"),
    "bench_drawing": ("FOLDER/small.nc --rounds 1", r"small \| \d.* \| \d"),
    "bench_engine": (f"--points 8 --steps 64 --repeat 1 --scene {SMALL}", r"small.toml: .* for labels only"),
    "bench_estimate": ("--points 2 --systems fixed_point", r"fixed_point: symmetric bodies \| \d"),
    "bench_label_checks": ("--points 20", r"labels of the fixed point differ at 0"),
    "bench_long_runs": ("--orbits 2", r"cylindrical +4 of 4 labels right"),
    "bench_methods": (f"{SMALL} --points 8 --rounds 1", r"small \| .*0 of 8 \| 0, 0"),
    "bench_large": ("0.00001 20", r"(?s)1024 points, \d chunks, .*map of numbers: .*join: "),
    "bench_proofs": (
        "--points 4 --duration 20",
        r"(?s)satellites with .* 0 contradictions.*tops: .* 0 contradictions",
    ),
    "bench_refine": (f"{SMALL} --count 5 --levels 1", r"small: 9 x 9 points, .* 0 labels differ"),
    "bench_scaling": ("100 --only points tiles", r"(?s)100, 1, .*tiles for 100 points"),
    "bench_elastic": ("1000 --kills 0 --jobs 1 --places store", r"store: 1000 points, .* 0 kills, .* equal"),
    "bench_start": (str(SMALL), r"first steps, .*small.toml: 0?\d+\.\d+ s"),
    "draw": ("--out FOLDER", r""),
    "evidence": ("--out FOLDER/evidence.json --only fixed_point", r"fixed_point: \d of \d differ"),
    "fuzz_scenes": ("--count 5 --runs 1 --points 1", r"check: ok"),
    "gallery": ("--out FOLDER --docs FOLDER --only first_order_error --count 3", r"wrote FOLDER"),
    "how_to": ("--out FOLDER --only dictionary", r"dictionary.png: \d+ kB"),
    "lagrange_form": ("--points 2 --steps 200", r"share unresolved"),
    "nonlinear_runs": (
        "--points 2 --duration 60 --starts 1 --nudges 0.01",
        r"random +arnold_moser .*(?s:.*)resonance_unstable",
    ),
    "notebooks": ("--out FOLDER", r"wrote first_atlas.ipynb"),
    "make_docs": ("--docs FOLDER", r"written: variables.md"),
}
PEERS = {
    "SciPy DOP853": "scipy",
    "SciPy odeint": "scipy",
    "heyoka batch": "heyoka",
    "numbalsoda dop853": "numbalsoda",
    "CyRK DOP853": "CyRK",
    "diffrax vmap Dopri8": "diffrax",
}

pytestmark = pytest.mark.usefixtures("whole_kernels", "coarse_lines", "script_folders")


@pytest.fixture
def script_folders(monkeypatch):
    """Import scripts by their names, each with its own folder as Python does; none chooses a processor."""
    for folder in FOLDERS:
        monkeypatch.syspath_prepend(folder)
    monkeypatch.delattr(os, "sched_setaffinity", raising=False)


def start(name, arguments, monkeypatch):
    """Run a script in this process."""
    monkeypatch.setattr("sys.argv", [name, *map(str, arguments)])
    code = None
    try:
        code = import_module(name).main()
    except SystemExit as end:
        code = end.code
    finally:
        logging.disable(logging.NOTSET)
    assert not code


@pytest.fixture
def less_work(script_folders, monkeypatch, tmp_path):
    """What would take seconds and is no matter of the scripts."""

    def command(folder, *arguments):
        monkeypatch.chdir(folder)
        assert cli.main(arguments) == cli.DONE
        return 1.0, 1.0

    def assembly(case):
        multiplied = njit("f8[::1](f8[::1], f8[::1])", fastmath=True)(lambda a, b: a * b + a)
        return next(iter(multiplied.inspect_asm().values()))

    def processor_time(python, atlas, name, out):
        if not Path(atlas).exists():
            command(tmp_path, "run", str(SMALL), "-o", atlas)
        return command(tmp_path, name, atlas, "-o", str(out), "--force")[0]

    def measure(folder, name, *words):
        monkeypatch.chdir(folder)
        if "-c" in words:
            exec(words[-1], {})
        elif words[0] != "cp":
            assert cli.main(words[3:]) == cli.DONE
        print(f"{name}: ")

    monkeypatch.setattr("bench_scaling.command", command)
    monkeypatch.setattr("bench_large.measure", measure)
    monkeypatch.setattr("bench_large.FLAGS", ("label", "status"))
    monkeypatch.setattr("bench_large.NUMBERS", 3)
    monkeypatch.setattr("bench_drawing.processor_time", processor_time)
    monkeypatch.setattr("bench_engine.Case.assembly", assembly)
    monkeypatch.setattr("bench_engine.PEAK_ROUNDS", 100)
    monkeypatch.setattr("bench_engine.CASES", import_module("bench_engine").CASES[::5])
    monkeypatch.setattr("bench_start.PROCESSES", 1)
    monkeypatch.setattr("gallery.PAPER_FIGURES", (4,))
    monkeypatch.setattr("gallery.DPI", 50)
    (tmp_path / "gallery").mkdir()
    pages = (ROOT / "docs" / "variables.md").read_text()
    (tmp_path / "variables.md").write_text(
        re.sub(r"(<!-- parameters satellite -->).*?(<!-- end)", r"\1\n\2", pages, flags=re.S)
    )


@pytest.mark.usual(
    "bench_any_axis", "bench_long_runs", "bench_methods", "bench_proofs", "fuzz_scenes", "make_docs"
)
@pytest.mark.usefixtures("less_work")
@pytest.mark.parametrize("name", SCRIPTS)
def test_script(name, monkeypatch, tmp_path, capfd):
    arguments, printed = SCRIPTS[name]
    start(name, arguments.replace("FOLDER", str(tmp_path)).split(), monkeypatch)
    assert re.search(printed, capfd.readouterr().out.replace(str(tmp_path), "FOLDER"))
    if name == "draw":
        assert all(
            (tmp_path / f"{each}.svg").stat().st_size > 10_000 for each in ("angles", "labels", "theory")
        )
    if name == "gallery":
        for file in ("first_order_error.pdf", "gallery/first_order_error.png", "fixed_point_figure_04.png"):
            assert (tmp_path / file).is_file()
    if name == "make_docs":
        assert (tmp_path / "variables.md").read_text() == (ROOT / "docs" / "variables.md").read_text()


@pytest.mark.usefixtures("whole_kernels")
def test_tables_are_those_of_the_registries(monkeypatch):
    start("make_docs", ["--check"], monkeypatch)


def test_the_packages_are_checked(tmp_path, monkeypatch, capsys):
    tool = import_module("check_packages")
    scripts = "atlas = atlas.cli:command\nprecession-atlas = atlas.cli:command\n[xarray.backends]\n"
    with zipfile.ZipFile(tmp_path / "a.whl", "w") as wheel:
        for file in tool.modules():
            wheel.writestr(file, "")
        wheel.writestr("precession_atlas-1.dist-info/entry_points.txt", scripts)
    with tarfile.open(tmp_path / "a.tar.gz", "w:gz") as source:
        for file in {*tool.modules(), *tool.SOURCES} - {"README.md"}:
            source.add(ROOT / file, f"a/{file}")
    monkeypatch.setattr("sys.argv", ["check_packages.py", str(tmp_path)])
    assert tool.main() == 1
    assert capsys.readouterr().out == "a.tar.gz: README.md is missing\n"
    monkeypatch.setattr(tool, "MAX_SOURCE", 10)
    assert tool.main() == 1
    assert capsys.readouterr().out.endswith(" bytes; at most 10: leave out pictures\n")


@pytest.mark.long
def test_a_mutant_is_killed_where_a_test_looks(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    monkeypatch.setenv("ATLAS_CACHE", str(tmp_path / "cache"))
    for folder in ("atlas", "tests", "scripts/tools", "cache/compiled"):
        (tmp_path / folder).mkdir(parents=True)
    shutil.copy(ROOT / "scripts" / "tools" / "mutants.py", tmp_path / "scripts" / "tools")
    source = "def area(a, b):\n    return a * b\n\n\ndef last(count):\n    return count - 1\n"
    (tmp_path / "atlas" / "__init__.py").touch()
    (tmp_path / "atlas" / "sizes.py").write_text(source)
    (tmp_path / "tests" / "test_sizes.py").write_text(
        "import os\n\nfrom atlas.sizes import area\n\n\n"
        "def test_area():\n    assert area(2, 3) == 6\n    assert os.listdir(os.environ['ATLAS_CACHE']) == ['compiled']\n"
    )
    command = [sys.executable, tmp_path / "scripts" / "tools" / "mutants.py", "0", "3"]
    table = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    for place, end in {
        "2:11": "killed by tests/test_sizes.py::test_area, survived without",
        "6:11": "survived",
        "6:19": "survived",
    }.items():
        (row,) = (row for row in table if row.startswith(f"atlas/sizes.py:{place} "))
        assert row.endswith(f"| {end}")
    assert (tmp_path / "atlas" / "sizes.py").read_text() == source


@pytest.mark.long
def test_the_core_is_tested_without_the_folder_of_an_extension(monkeypatch, capfd):
    """One short test of it, which fails where the records of other extensions are not read."""
    start("without_extension", ["basins", "tests/test_extensions.py", "-k", "reserved", "-q"], monkeypatch)
    assert "1 passed" in capfd.readouterr().out


@pytest.mark.usual("heyoka batch", "numbalsoda dop853", "CyRK DOP853", "diffrax vmap Dopri8")
@pytest.mark.parametrize("name", PEERS)
def test_a_peer_integrates_the_same_motions(name):
    pytest.importorskip(PEERS[name], reason=f"{name} is of the extra `peers`")
    bench = import_module("bench_peers")
    study = replace(bench.STUDIES["random"], duration=0.5)
    points = bench.satellites(2)
    peers = bench.all_peers(study, points)
    results = bench.measure_all(study, {name: peers[name].make()}, peers, points, 1)
    assert min(level.error for level in results[name]) < 1e-12


@pytest.mark.long
def test_times_of_peers_are_written_into_the_pages(tmp_path, monkeypatch):
    pages = ["README.md", "docs/accuracy.md", "docs/paper/paper.md"]
    (tmp_path / "docs" / "paper").mkdir(parents=True)
    for page in pages:
        shutil.copy(ROOT / page, tmp_path / page)
    start(
        "bench_peers",
        ["--points", 2, "--rounds", 1, "--duration", 1, "--only", "DOP853", "--docs", tmp_path],
        monkeypatch,
    )
    readme, accuracy, paper = ((tmp_path / page).read_text() for page in pages)
    (table,) = re.findall(r"<!-- peers_table -->\n(.*?\n)<!-- end -->", paper, re.S)
    assert table in accuracy
    assert "with `rk8`" in readme
    assert "Random bodies to T = 1, best of 1 rounds" in accuracy
    compared = re.search(r"<!-- peers_all -->\n(.*?)<!-- end -->", accuracy, re.S)[1]
    for bodies in ("2 satellites", "1 tops", "1 x 8 satellites", "1 x 8 tops", "2 slender satellites"):
        assert f"| {bodies}, T = 1, 1e-08 |" in compared
    for text, page in zip((readme, accuracy, paper), pages, strict=True):
        assert text != (ROOT / page).read_text()
    assert (tmp_path / "docs" / "peers.png").is_file()
