"""What tests replace below `atlas`, and the private names of it that they use: one list with the reasons.

A test that replaces what it tests proves little, and one that names what is private hinders its change. Boundaries are the clock,
the disk, the network, the processors and the installed packages; whatever else is replaced here has no public way yet.
"""

import ast
import tomllib
from collections import defaultdict
from collections.abc import Collection, Iterator
from contextlib import suppress
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
PACKAGE = TESTS.parent / "atlas"
PROJECT = tomllib.loads((TESTS.parent / "pyproject.toml").read_text())["project"]
# Without the folder of one of them its names are not used.
EXTENSIONS = PROJECT["entry-points"]["atlas.extensions"].keys()
REPLACING = {"setattr", "delattr", "setitem", "delitem", "object"}
# Of named tuples and of objects that Jupyter shows: public in spite of the underscore.
PUBLIC = {"_replace", "_make", "_fields", "_asdict", "_repr_html_", "_exit"}

# Names that tests replace, by the reason.
REPLACED = {
    "the clock": """
        interruption.GRACE_PERIOD interruption.MESSAGE_PERIOD kernel.compiling._finished kernel.compiling.time
        runs.claims.CLAIM_AGE runs.claims.CLAIM_INTERVAL runs.claims.NAMED_AFTER runs.claims.time runs.cluster.CONNECT_TIMEOUT runs.folder.Event
        runs.folder.time runs.memory.Execution.time_is_up runs.run.time store.place.time.monotonic store.place.time.sleep store.progress.PLAIN_INTERVAL
        store.progress.compiling.Stopwatch.seconds
    """,
    "the disk: full, read-only, without hard links, with other contents; and how often it is read": """
        files.MIN_FREE_BYTES files.os.fsync files.os.link files.os.replace files.secrets.token_hex
        files.tempfile.TemporaryFile kernel.machine_code.atomic_write plotting.style.atomic_write runs.estimate.check_disk
        runs.estimate.shutil.disk_usage runs.refine.shutil.disk_usage runs/test_folder.py:?.read plotting/test_maps.py:?.savefig
        store.tile.Tiles.read test_stability.py:?.SNAPSHOT test_stability.py:?.public
    """,
    "the network, and what else does not answer": """
        interruption.end_process cli.scenes.print_schema runs.cluster.connect store.place.Folder.names store.place.Objects.?
    """,
    "the processors, the memory and the programs of this machine": """
        extensions/page/test_in_browser.py:?.browser.launched kernel.blocks.os.sched_getaffinity kernel.machine_code.architecture
        kernel.intrinsics.VECTOR_BITS kernel.machine_code.llvm.get_host_cpu_features plotting.trajectory.ANIMATIONS..mp4 runs.folder.identity
        runs.refine.os.sysconf runs.reuse.identity runs/test_identity.py:?.? test_scripts.py:?.MAX_SOURCE
    """,
    "the installed packages, their code, and the systems, instruments and methods of this process": """
        extension._found sources.AT_IMPORT sources.OF_FOLDERS.? sources.PACKAGE sources.read systems.SYSTEMS
        systems.steady.arithmetic.functions kernel.tableaux.METHODS.rk6 variables.INSTRUMENTS
    """,
    "another process, or the end of this one, at this very moment": """
        runs.folder.complete runs.run.RunFolder.? runs.run.RunFolder.join runs.run.RunFolder.prepare runs.run.RunFolder.remove
        runs.memory.evaluate runs/test_zarr.py:?.?
    """,
    "what is computed, call by call": """
        analysis.boundary.theory_borders extensions.studies.convergence.columns_of extensions.certificate.energy.reach
        kernel.specialization.kernel runs.estimate._measure
        measure.tangent_runs.TangentRuns.of runs.estimate.derived_values runs.estimate.evaluate runs.estimate.predict_runs
        runs.folder.evaluate_at
        systems.satellite.SATELLITE.?
    """,
    "a limit or the size of a piece that has no setting: at its value the test would take minutes or gigabytes": """
        analysis.metadata.MAX_POINTS analysis.select.MAX_CELLS analysis.tracer.? analysis.tracer.WORTH_KEEPING
        extensions.amer2013.fast_spin.CHUNK extensions.amer2013.fast_spin.MAX_EVALUATIONS kernel.blocks.CHUNK
        kernel.integrate.QUEUE kernel.numeric_bound.MAX_SAMPLES label.pipeline.POINTS_PER_HALF_STEP runs.refine.MAX_BOX_POINTS runs.refine.MAX_PREDICTED
        scene.points.MAX_FILE_BYTES scene.tables.MAX_TABLE store.dataset.MAX_EAGER_VALUES store.netcdf.MAX_ROW_VALUES
        store.tile.TILES_PER_FOLDER
        test_docs.py:?.example
        store.tiling.Tiling.indices systems.base._CHUNK systems.gyrostat.fundamental.LANES
    """,
    "speed, where a test looks at something else": """
        extensions.catalogue.tables.N_SAMPLES analysis.tracer.COARSE_SAMPLES
        analysis.tracer.LINES_FOLDER extensions.normal_form.lines.RESONANCE_SAMPLES extensions.page.content.MAX_SLICES
        extensions.page.page._file_text extensions.page.page._fallback kernel.specialization.Specialization.of
        label.plan.Plan.kernel label.plan.Plan.kernel_hash label.points.MANY_STEPS label.points._advised plotting.style.STYLE.savefig.dpi runs.estimate.LONG
        runs.estimate.CALIBRATION_STEPS runs.estimate.LABEL_STEPS
        runs.estimate.long_run runs.memory.LONG systems.gyrostat.fundamental._compile extensions.studies.stress.generic_cases
        extensions.studies.stress.limits extensions.studies.stress.stress extensions.studies.work_precision.POINT_STEPS_TIMED
    """,
    "one of two ways to a result, so that the other is tested alone": """
        kernel.ensemble.np kernel.numeric_bound.OVERTONE label.theory.rounding_limit measure.circle.is_steady
        measure.circle.label_of_third_axis runs.memory.evaluate_at scene.grid.possible_body
        systems.gyrostat.floquet._MAX_STEPS systems/test_observables.py:?.frequency_bound
        extensions.periodic.families.ANGLE
        extensions.periodic.families.GROWTH
        extensions.periodic.families.LONGEST
    """,
    "a failure or an error of a known size that no input brings about": """
        extensions.amer2013.fast_spin.dop853 extensions.page.page.sources measure.rates.Rates.differences
        systems/test_observables.py:?.initial_state label.half_step.evaluate measure.tangent_runs.Separation extensions.studies.reference._integrate_group
    """,
}  # fmt: skip

# Private names that tests read or call, by the reason.
PRIVATE = {
    "caches, which a test that changes what they depend on clears": """
        analysis.metadata._registry extension._found runs.folder._open_cached variables._registry
    """,
    "forged files, which carry the hashes of whole ones": """
        kernel.machine_code._with_hash kernel/test_machine_code.py:?._cache kernel/test_machine_code.py:?._cache._place
        runs.run._key store.netcdf._hash store.zarr_store._root_hash
    """,
    "Matplotlib, whose animations are drawn frame by frame": """
        plotting/test_trajectory_figure.py:?._draw_was_started plotting/test_trajectory_figure.py:?._fig
        plotting/test_trajectory_figure.py:?._func shown/test_shown_motions.py:?._draw_was_started
        shown/test_shown_motions.py:?._fig shown/test_shown_motions.py:?._func
    """,
    "Matplotlib, which tells the dashes of lines no other way": """
        readers.py:?._unscaled_dash_pattern
    """,
    "a step of a calculation whose inputs no public call takes, or at a hundred times the cost": """
        extensions.studies.convergence._with_setting extensions.lagrangian.lagrangian._is_singular
        runs.cluster._has_result runs.folder._Job store.zarr_store._unpacked_bytes runs.refine._decode runs.refine._encode
        extensions.studies.exact._quadrature extensions.studies.reference._dop853 extensions.studies.reference._integrate_group
        label.any_axis._circle label.pipeline._sample label.pipeline._step_decides label.theory._statistics
    """,
}  # fmt: skip


def origins(tree: ast.AST) -> dict[str, str]:
    """Dotted names of what a module imports, and of its own classes, by the names that it gives them."""
    names = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for each in node.names:
                top = each.name.partition(".")[0]
                names[each.asname or top] = each.name if each.asname else top
        elif isinstance(node, ast.ImportFrom):
            names |= {each.asname or each.name: f"{node.module}.{each.name}" for each in node.names}
        elif isinstance(node, ast.ClassDef):
            names[node.name] = f"tests.{node.name}"
    return names


def dotted(node: ast.AST, names: dict[str, str]) -> str:
    """The dotted name of an expression; "?" stands for what only the running test knows."""
    match node:
        case ast.Name(name):
            return names.get(name, "?")
        case ast.Attribute(value, name):
            return f"{dotted(value, names)}.{name}"
        case ast.Constant(value):
            return str(value)
    return "?"


def uses(tree: ast.AST) -> Iterator[tuple[str, str]]:
    """Every replaced and every private name; those in programs that a text of the module contains as well."""
    names = origins(tree)
    for node in ast.walk(tree):
        match node:
            case ast.Call(ast.Attribute(_, name), [ast.Constant(str(text)), *_]) if name in REPLACING | {
                "patch"
            }:
                yield "replaced", text
            case ast.Call(ast.Attribute(_, name), [target, which, *_]) if name in REPLACING:
                yield "replaced", f"{dotted(target, names)}.{dotted(which, {})}"
            case ast.Assign(targets):
                for target in targets:
                    if isinstance(target, ast.Attribute) and dotted(target, names).startswith("atlas."):
                        yield "replaced", dotted(target, names)
            case ast.ImportFrom(str(module), imported) if module.startswith("atlas"):
                for each in imported:
                    if is_private(each.name):
                        yield "private", f"{module}.{each.name}"
            case ast.Attribute(value, name) if is_private(name) and dotted(value, {"self": "self"}) != "self":
                yield "private", dotted(node, names)
            case ast.Constant(str(text)) if "\n" in text and "import " in text:
                with suppress(SyntaxError):  # no program
                    yield from uses(ast.parse(text))


def is_private(name: str) -> bool:
    """Whether a name is private; those between double underscores belong to the language."""
    return name.startswith("_") and not name.startswith("__") and name not in PUBLIC


def names_used(folder: Path) -> dict[str, dict[str, list[str]]]:
    """Modules of the replaced and the private names below `atlas`; "?" is preceded by the module in which it stands."""
    places: dict[str, dict[str, list[str]]] = {"replaced": defaultdict(list), "private": defaultdict(list)}
    for path in sorted(folder.rglob("*.py")):
        module = path.relative_to(folder).as_posix()
        for kind, name in uses(ast.parse(path.read_text())):
            if name.startswith("?"):
                places[kind][f"{module}:{name}"].append(module)
            elif name.startswith("atlas."):
                places[kind][name.removeprefix("atlas.")].append(module)
    return places


def test_every_name_that_is_replaced_or_private_has_a_reason():
    used_of = names_used(TESTS)
    for kind, reasons in (("replaced", REPLACED), ("private", PRIVATE)):
        listed = sorted(name for names in reasons.values() for name in names.split())
        assert listed == sorted(set(listed))
        used = used_of[kind].keys()
        assert used - set(listed) == set()
        if {path.name for path in (TESTS / "extensions").iterdir()} >= EXTENSIONS:
            assert set(listed) - used == set()


def imports_of(path: Path, modules: Collection[str]) -> set[str]:
    """Modules of the package that a file of it imports anywhere, also for type checkers."""
    package, imported = ("atlas", *path.relative_to(PACKAGE).parent.parts), set[str]()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            above = package[: len(package) + 1 - node.level] if node.level else ()
            base = ".".join([*above, *filter(None, [node.module])])
            imported |= {name if (name := f"{base}.{each.name}") in modules else base for each in node.names}
    return imported & set(modules)


@pytest.mark.long
def test_no_file_imports_itself_through_others():
    paths = {path.relative_to(PACKAGE.parent).with_suffix(""): path for path in PACKAGE.rglob("*.py")}
    modules = {".".join(name.parts).removesuffix(".__init__"): path for name, path in paths.items()}
    below = {name: imports_of(path, modules) - {name} for name, path in modules.items()}
    while leaves := {name for name, imported in below.items() if not imported & below.keys()}:
        below = {name: imported for name, imported in below.items() if name not in leaves}
    assert below == {}
