"""Settings shared by all tests, and the scene that most of them change a little."""

import gc
import os
import shutil
import signal
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest
import tomli_w
from hypothesis import settings

# Before NumPy is loaded: with a test process on each processor, further threads of its linear algebra only wait.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("ATLAS_CACHE", str(Path(__file__).parent.parent / ".pytest_cache" / "kernels"))
# Processes in the background of a shell ignore SIGINT, and so would every process that a test starts and interrupts.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # nohup does the same with SIGHUP
settings.register_profile("atlas", deadline=None, max_examples=50, derandomize=True)
settings.load_profile("atlas")

SMALL_SCENE = (Path(__file__).parent / "small.toml").read_text()


def changed_scene(changes: Mapping[str, object]) -> str:
    """Text of the small scene after changes, which map a dotted key to its new value; None removes the key.

    A mistyped key raises here if it is removed, otherwise when the scene is read.
    """
    table = tomllib.loads(SMALL_SCENE)
    for key, value in changes.items():
        *sections, name = key.split(".")
        section = table
        for each in sections:
            section = section.setdefault(each, {})
        if value is None:
            del section[name]
        else:
            section[name] = value
    return tomli_w.dumps(table)


def pytest_addoption(parser):
    """Add the strength of the tests that kill processes and damage files."""
    parser.addoption(
        "--fault-rounds", type=int, default=3, help="repetitions of kills and damage (default: 3)"
    )


@pytest.fixture
def fault_rounds(request) -> int:
    """Number of repetitions of kills and damage."""
    return request.config.getoption("--fault-rounds")


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Exempt modules and tests, which live to the end, from garbage collection, and collect other objects less often."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.set_threshold(5_000)
        gc.enable()


def pytest_runtest_setup(item):
    """Skip a test of the core that uses an extension which is not installed."""
    from atlas.extension import extensions

    missing = {mark.args[0] for mark in item.iter_markers("extension")} - extensions().keys()
    if missing:
        pytest.skip(f"needs {', '.join(sorted(missing))}")


def pytest_collection_modifyitems(config, items):
    """Make those cases of a test long that its mark `usual` does not name; begin with the module of the longest fixtures.

    Idle processes take over the last tests of the others.
    """
    unknown = {}
    for item in items:
        if mark := item.get_closest_marker("usual"):
            named = {each for each in mark.args if f"-{each}-" in f"-{item.callspec.id}-"}
            unknown.setdefault(item.nodeid.partition("[")[0], set(mark.args)).difference_update(named)
            if not named:
                item.add_marker(pytest.mark.long)
    if any(unknown.values()) and not any("::" in each for each in config.args):  # which select single cases
        raise pytest.UsageError(
            f"no case is called: {', '.join(f'{k}: {v}' for k, v in unknown.items() if v)}"
        )
    items.sort(key=lambda item: item.path.name != "test_stress.py")


@pytest.fixture(scope="session")
def scene_text() -> Callable[[Mapping[str, object]], str]:
    """Function that returns the text of the small scene after changes: scene_text({"fixed.m": 0.6})."""
    return changed_scene


@pytest.fixture(scope="session")
def small_scene() -> str:
    """Text of a scene of 63 points that runs in milliseconds."""
    return SMALL_SCENE


@pytest.fixture(scope="session")
def without_family():
    """Changes of the small scene that leave its points where the axes put them."""
    return {"family": None, "nudge": None, "labels": None, "integration": {"duration": 3.0}}


@pytest.fixture(scope="module")
def whole_kernels():
    """Integrate every point with the kernel that has all terms, also terms that vanish at the points of a test.

    That kernel is compiled once for all modules that use it; a kernel for each set of terms takes some 10 s.
    `tests/kernel/test_simplify.py` compares both kinds.
    """
    from atlas.kernel.specialization import GENERIC, Specialization

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Specialization, "of", classmethod(lambda cls, system, zero, equal: GENERIC))
        yield


@pytest.fixture(scope="module")
def short_timings():
    """Time the kernels of work-precision studies on a hundredth of the steps."""
    try:
        from atlas.extensions.studies import work_precision
    except ModuleNotFoundError:  # the extension is not installed
        yield
        return
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(work_precision, "POINT_STEPS_TIMED", work_precision.POINT_STEPS_TIMED // 100)
        yield


@pytest.fixture(scope="session", autouse=True)
def few_dots():
    """Save figures with fewer dots per inch than for print (the value), because saving is half of the time of a map."""
    from atlas.plotting import style

    with pytest.MonkeyPatch.context() as patched:
        print_dpi = style.STYLE["savefig.dpi"]
        patched.setitem(style.STYLE, "savefig.dpi", 100)
        yield print_dpi


@pytest.fixture(scope="module")
def coarse_lines():
    """Trace lines of theory from a ninth of the samples, for modules whose tests look at no figure.

    These lines have a cache of their own.
    """
    from atlas.analysis import tracer

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(tracer, "COARSE_SAMPLES", tracer.COARSE_SAMPLES // 3)
        patched.setattr(tracer, "LINES_FOLDER", "coarse_lines")
        yield


@pytest.fixture(scope="module")  # as `whole_kernels`, which change its bits
def longer_atlas(scene_text):
    """Text of a scene of about a second, and its result computed in memory."""
    import atlas

    text = scene_text({"axes.sigma.count": 18, "axes.theta0.count": 48, "integration.tolerance": 1e-9})
    return text, atlas.run(atlas.load_scene(text), progress=False)


@pytest.fixture
def longer(tmp_path, longer_atlas, monkeypatch):
    """Folder of that scene in 18 tiles, its empty run folder, and its result computed in memory."""
    from atlas import load_scene
    from atlas.runs.plan import ScenePlan
    from atlas.runs.run import RunFolder

    text, whole = longer_atlas
    (tmp_path / "scene.toml").write_text(text)
    scene = load_scene(tmp_path / "scene.toml")
    with monkeypatch.context() as patched:
        patched.setenv("ATLAS_TILE_POINTS", "64")
        run = RunFolder.prepare(plan := ScenePlan.of(scene), tmp_path / "run")
    assert run.tiling.count == 18
    assert plan.runs.kernel_hash == whole.atlas_kernel_hash
    return tmp_path, run, whole


@pytest.fixture
def own_systems():
    """Forget the systems that a test registers."""
    from plugins import registry

    with registry():
        yield


@pytest.fixture
def installed_extensions():
    """Function that replaces the lists of extensions, and of those that cannot be loaded, until the end of the test.

    Without arguments it searches the installed packages anew.
    """
    import atlas.variables
    from atlas import extension
    from atlas.analysis import metadata
    from atlas.systems import base

    patched = pytest.MonkeyPatch()
    caches = (
        extension._found, extension.parts, base.families_of, base.derived_variables, atlas.variables._registry,
        metadata._registry,
    )  # fmt: skip

    def replace(found: Mapping[str, object] | None = None, broken: dict[str, str] | None = None) -> None:
        if found is not None:
            noted = {} if broken is None else broken
            patched.setattr(extension, "_found", lambda: (dict(found), noted))
        for each in caches:
            each.cache_clear()

    yield replace
    patched.undo()
    for each in caches:
        each.cache_clear()


@pytest.fixture
def without_extension(installed_extensions):
    """Function of a name that makes an extension seem not installed, until the end of the test."""
    from atlas.extension import extensions

    return lambda name: installed_extensions({key: e for key, e in extensions().items() if key != name})


@pytest.fixture
def install_example(installed_extensions, tmp_path_factory):
    """Function of a name that installs a package of docs/examples for this process and its children."""
    import plugins

    with pytest.MonkeyPatch.context() as patched:

        def install(name: str) -> None:
            site = tmp_path_factory.mktemp("site")
            for folder in (site, plugins.install_example(name, site)):
                patched.syspath_prepend(folder)
                patched.setenv("PYTHONPATH", str(folder), prepend=os.pathsep)
            installed_extensions()

        yield install


@pytest.fixture
def copied_package(tmp_path):
    """A copy of the package, and the variables of processes that import it."""
    copy = tmp_path / "copy" / "atlas"
    # Compiled modules too, but not files that another process is writing.
    shutil.copytree(Path(__file__).parents[1] / "atlas", copy, ignore=shutil.ignore_patterns("*.pyc.*"))
    return copy, {"PYTHONPATH": str(copy.parent)}


@pytest.fixture(scope="module")
def server():
    """An S3 server with a bucket, in a thread of this process."""
    import logging
    import urllib.request

    moto = pytest.importorskip("moto.server")
    server = moto.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    host, port = server.get_host_and_port()
    address = f"http://{host}:{port}"
    urllib.request.urlopen(urllib.request.Request(f"{address}/bucket", method="PUT")).close()
    variables = {
        "ENDPOINT": address,
        "ACCESS_KEY_ID": "a",
        "SECRET_ACCESS_KEY": "b",
        "REGION": "us-east-1",
        "ALLOW_HTTP": "true",
    }
    with pytest.MonkeyPatch.context() as patched:
        for name, value in variables.items():
            patched.setenv(f"AWS_{name}", value)
        yield server
    server.stop()


@pytest.fixture
def steps_of_theory(monkeypatch):
    """Names of the methods that theory calls to identify motions of a satellite and decide their stability, in order of calls."""
    from atlas.systems.satellite import SATELLITE

    calls = []

    def counted(name, method):
        return lambda *arguments: calls.append(name) or method(*arguments)

    for name in ("identify_family", "frequencies", "energy_stability", "linear_stability"):
        monkeypatch.setattr(SATELLITE, name, counted(name, getattr(SATELLITE, name)))
    return calls


@pytest.fixture
def evaluated(monkeypatch):
    """Number of points of each integration, in order."""
    from atlas.runs import memory

    sizes, evaluate = [], memory.evaluate

    def counted(plan, points, **options):
        sizes.append(int(points.exists.sum()))
        return evaluate(plan, points, **options)

    monkeypatch.setattr(memory, "evaluate", counted)
    return sizes


@pytest.fixture
def interrupt(monkeypatch, evaluated):
    """Function of a number k that interrupts the k-th integration after its call, which `evaluated` then does not count."""
    from atlas.runs import memory

    def interrupt(number: int) -> None:
        calls, evaluate = 0, memory.evaluate

        def interrupted(*arguments, **options):
            nonlocal calls
            calls += 1
            if calls == number:
                raise KeyboardInterrupt
            return evaluate(*arguments, **options)

        monkeypatch.setattr(memory, "evaluate", interrupted)

    return interrupt
