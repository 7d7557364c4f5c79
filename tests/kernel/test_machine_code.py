"""The cache of compiled kernels, and Numba as other libraries of the process see it."""

import errno
import os
import pickle
import re
import shutil
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import llvmlite.binding as llvm
import numba
import numpy as np
import pytest

from atlas import files
from atlas.kernel import machine_code
from atlas.kernel.compiling import ANNOUNCEMENT, announced
from atlas.systems.satellite.system import SATELLITE

# A point at which no term of the equations vanishes: its kernel is that of many other tests.
ALL_TERMS = {name: 1.0 + i / 50 for i, name in enumerate(SATELLITE.parameters)}


@pytest.mark.long
def test_an_edited_line_is_never_answered_by_a_stale_kernel(copied_package, tmp_path):
    """A copy of the package, one sign of the right-hand side edited: the result must change; a comment must not."""
    package, variables = copied_package
    code = (
        "import atlas; from atlas.kernel.specialization import kernel_hash, source; from atlas.systems import SYSTEMS\n"
        f"ds = atlas.label_points('satellite', {ALL_TERMS}, duration=5.0, tolerance=1e-6)\n"
        "result = [kernel_hash(source(SYSTEMS['satellite'], 'rk4')), float(ds.theta_dot_rms[0]).hex()]\n"
    )

    def result() -> list[str]:
        done = subprocess.run(
            [sys.executable, "-c", f"{code}print(*result)"], cwd=tmp_path, capture_output=True, text=True, check=True,
            env=variables | {"PATH": "", "ATLAS_CACHE": os.environ["ATLAS_CACHE"], "HOME": str(tmp_path)},
        )  # fmt: skip
        return done.stdout.split()

    path = package / "systems" / "satellite" / "equations.py"
    original, names = path.read_text(), {}
    exec(code, names)  # with the package itself
    commented = original.replace("H1, H2, H3 =", "# a comment\n    H1, H2, H3 =", 1)
    assert commented != original
    path.write_text(commented)
    assert result() == names["result"]
    edited = original.replace("- N * D1 * a2 * a3", "+ N * D1 * a2 * a3", 1)
    assert edited != original
    path.write_text(edited)
    changed = result()
    assert changed[0] != names["result"][0]
    assert changed[1] != names["result"][1]


SOURCE = f"{machine_code.HEADER}\n\n{machine_code.KERNEL}\ndef integrate(x):\n    return x + 1.0\n"


def fresh(source: str = SOURCE):
    """The module of a kernel as a new process gets it."""
    sys.modules.pop(f"atlas_kernel_{machine_code.digest(source)}", None)
    return machine_code.load(source)


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty cache folder that does not exist yet."""
    monkeypatch.setenv("ATLAS_CACHE", str(tmp_path / "kernels"))
    return tmp_path / "kernels"


# Loops of fewer operations are unrolled before they could become vectors.
POLYNOMIAL = "1.0 - z * (0.5 - z * (0.25 - z * (0.125 - z * (0.1 - z * (0.2 - z * (0.3 - z * (0.4 - z)))))))"
LANES = f"""def integrate(x, steps):
    full_vectors()
    y = aligned_empty((1, 32))
    for l in range(32):
        y[0, l] = x[l]
    for _ in range(steps):
        for l in range(32):
            z = y[0, l]
            y[0, l] = {POLYNOMIAL}
    for l in range(32):
        x[l] = y[0, l]"""


def test_loops_over_the_lanes_become_the_longest_vectors_of_the_processor(cache):
    module = machine_code.load(machine_code.module_text({}, {"integrate": LANES}, machine_code.INLINE))
    x = np.linspace(-1.0, 1.0, 32)
    expected = eval(POLYNOMIAL, {"z": x})
    module.integrate(x, 1)
    assert np.allclose(x, expected, rtol=1e-14, atol=0)
    (assembly,) = module.integrate.inspect_asm().values()
    features = llvm.get_host_cpu_features()
    longest = {"avx512f": r"pd\s.*%zmm", "avx": r"pd\s.*%ymm", "sse2": r"pd\s.*%xmm", "neon": r"\s.*v\d+\.2d"}
    vectors = next(pattern for feature, pattern in longest.items() if features.get(feature))
    assert re.search(rf"\s(?:v?mul|vfn?m\w+|fml[as]|fmul){vectors}", assembly)


def test_machine_code_comes_from_the_cache_and_only_its_user_can_read_it(cache, caplog):
    usual = os.umask(0)
    try:
        assert fresh().integrate(1.0) == 2.0
    finally:
        os.umask(usual)
    (file,) = cache.iterdir()
    assert cache.stat().st_mode & 0o777 == 0o700
    assert file.stat().st_mode & 0o777 == 0o600
    module = fresh()
    assert module.integrate(1.0) == 2.0
    assert sum(module.integrate.stats.cache_hits.values()) == 1
    assert caplog.messages == []


# A kernel of three functions.
SHIFTED = f"{machine_code.HEADER}\nK = 2.0\n\n\n{machine_code.INLINE}\ndef scaled(x):\n    return K * x\n\n\n{machine_code.INLINE}\n"
SHIFTED += f"def shifted(x):\n    return scaled(x) + 1.0\n\n\n{machine_code.KERNEL}\ndef integrate(x):\n    return shifted(x)\n"


def test_kernels_share_the_machine_code_of_equal_functions(cache):
    text = SHIFTED
    other = text.replace("return shifted(x)", "return shifted(x) + scaled(x)")
    for source, result, hits in ((text, 7.0, 0), (other, 13.0, 1), (text.replace("2.0", "5.0"), 16.0, 0)):
        module = fresh(source)
        assert module.integrate(3.0) == result
        assert sum(module.shifted.stats.cache_hits.values()) == hits
    kernels = [machine_code.is_kernel(name) for name in machine_code.cached()]
    assert (kernels.count(True), kernels.count(False)) == (3, 4)
    assert machine_code.clear() == 3
    assert machine_code.cached() == {}


def test_a_kernel_is_announced_when_it_is_compiled_and_not_when_it_is_cached(cache, capsys):
    with announced(True):
        for compiled in (True, False):
            assert fresh().integrate(1.0) == 2.0
            assert capsys.readouterr().err == (f"{ANNOUNCEMENT}\n" if compiled else "")
    fresh(SOURCE.replace("1.0", "2.0")).integrate(1.0)
    assert capsys.readouterr().err == ""


def replaced_by_a_folder(file: Path) -> None:
    file.unlink()
    (file / "inside").mkdir(parents=True)


def replaced_by_a_pipe(file: Path) -> None:
    file.unlink()
    os.mkfifo(file)


def replaced_by_a_link(file: Path) -> None:
    file.rename(file.parent.parent / "elsewhere")
    file.symlink_to(file.parent.parent / "elsewhere")


def flipped(content: bytes, position: float) -> bytes:
    i = int(position * len(content))
    return content[:i] + bytes([content[i] ^ 4]) + content[i + 1 :]


DAMAGES = {
    "empty": lambda file: file.write_bytes(b""),
    "truncated": lambda file: file.write_bytes(file.read_bytes()[:-20]),
    "cut in its hash": lambda file: file.write_bytes(file.read_bytes()[:10]),
    "zeroed": lambda file: file.write_bytes(bytes(file.stat().st_size)),
    "bit of the hash": lambda file: file.write_bytes(flipped(file.read_bytes(), 0.0)),
    "bit of the code": lambda file: file.write_bytes(flipped(file.read_bytes(), 0.5)),
    "last bit": lambda file: file.write_bytes(flipped(file.read_bytes(), 0.9999)),
    "text": lambda file: file.write_text("import os"),
    "folder": replaced_by_a_folder,
    "pipe": replaced_by_a_pipe,
    "link": replaced_by_a_link,
    "writable by others": lambda file: file.chmod(0o666),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_file_is_compiled_again_with_one_warning_and_repaired(damage, cache, caplog):
    assert fresh().integrate(1.0) == 2.0
    (file,) = cache.iterdir()
    DAMAGES[damage](file)
    assert fresh().integrate(1.0) == 2.0
    (message,) = caplog.messages
    assert str(file) in message
    assert "compiling again" in message
    assert "\n" not in message
    repaired = fresh()
    assert repaired.integrate(1.0) == 2.0
    assert sum(repaired.integrate.stats.cache_hits.values()) == 1
    assert list(cache.iterdir()) == [file]
    assert len(caplog.messages) == 1


def test_the_file_of_another_kernel_is_not_used(cache, caplog):
    other = SOURCE.replace("1.0", "5.0")
    assert fresh().integrate(1.0) == 2.0
    (file,) = cache.iterdir()
    assert fresh(other).integrate(1.0) == 6.0
    (other_file,) = set(cache.iterdir()) - {file}
    shutil.copyfile(other_file, file)
    assert fresh().integrate(1.0) == 2.0
    assert len(caplog.messages) == 1


class Planted:
    """Creates a file when it is unpickled."""

    def __init__(self, witness: Path):
        self.witness = witness

    def __reduce__(self):
        return Path.touch, (self.witness,)


def plant(file: Path, witness: Path) -> None:
    """Write a file with a valid hash that runs code when it is loaded, as another user of the folder could."""
    dispatcher = machine_code.load(SOURCE).integrate
    (signature,) = dispatcher.overloads
    _, key = dispatcher._cache._place(signature, dispatcher.overloads[signature].codegen)
    file.write_bytes(machine_code._with_hash(key, pickle.dumps((Planted(witness),))))
    file.chmod(0o600)


REASONS = {
    "mode 777": "can be written by other users",
    "mode 770": "can be written by other users",
    "another owner": "belongs to another user",
    "link": "is a symbolic link",
    "file": "is not a folder",
}


@pytest.mark.parametrize("danger", REASONS)
def test_nothing_is_executed_from_a_folder_that_others_may_have_filled(danger, cache, caplog, monkeypatch):
    assert fresh().integrate(1.0) == 2.0
    (file,) = cache.iterdir()
    witness = cache.parent / "executed"
    plant(file, witness)
    if danger.startswith("mode"):
        cache.chmod(int(danger.removeprefix("mode "), 8))
    elif danger == "another owner":
        owner = os.geteuid()
        monkeypatch.setattr(os, "geteuid", lambda: owner + 1)
    else:
        cache.rename(cache.parent / "real")
        if danger == "link":
            cache.symlink_to(cache.parent / "real")
        else:
            cache.write_text("")
    before = file.read_bytes() if danger != "file" else b""
    for source, value in ((SOURCE, 2.0), (SOURCE.replace("1.0", "7.0"), 8.0)):
        assert fresh(source).integrate(1.0) == value
    assert not witness.exists()
    (message,) = caplog.messages
    assert f"{cache} {REASONS[danger]}: nothing in it is used, compiling in memory" in message
    assert "ATLAS_CACHE" in message
    if danger != "file":
        assert list(cache.iterdir()) == [file]
        assert file.read_bytes() == before


def test_the_planted_file_would_be_executed_in_a_private_folder(cache):
    """So that the test before cannot pass because of a plant that does nothing."""
    assert fresh().integrate(1.0) == 2.0
    (file,) = cache.iterdir()
    plant(file, cache.parent / "executed")
    assert fresh().integrate(1.0) == 2.0
    assert (cache.parent / "executed").exists()


def test_a_full_or_read_only_disk_compiles_in_memory_with_one_warning(cache, caplog, monkeypatch):
    @contextmanager
    def full(path, durable=True):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        yield

    monkeypatch.setattr(machine_code, "atomic_write", full)
    assert fresh().integrate(1.0) == 2.0
    assert fresh().integrate(1.0) == 2.0
    (message,) = caplog.messages
    assert f"{cache} cannot be written (No space left on device): compiling in memory" in message


def test_a_folder_that_vanishes_is_made_again(cache, caplog):
    assert fresh().integrate(1.0) == 2.0
    shutil.rmtree(cache)
    assert fresh().integrate(1.0) == 2.0
    assert len(list(cache.iterdir())) == 1
    assert caplog.messages == []


KILLED = """
import itertools, os, signal
from pathlib import Path
from atlas.kernel import machine_code

replace = os.replace
for number in range(3):
    if process := os.fork():
        print(-os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]))
        continue
    calls = itertools.count()

    def killed(*names):
        if next(calls) == number:
            os.kill(os.getpid(), signal.SIGKILL)
        replace(*names)

    os.replace, os.environ["ATLAS_CACHE"] = killed, str(Path("kernels") / str(number))
    machine_code.load({source!r}).integrate(3.0)
"""


@pytest.mark.long
def test_processes_that_are_killed_while_they_compile_leave_whole_functions(cache, caplog, monkeypatch):
    """The next one takes them from the folder, compiles the others, and leaves nothing else there."""
    code = KILLED.format(source=SHIFTED)
    done = subprocess.run([sys.executable, "-c", code], cwd=cache.parent, capture_output=True, text=True)
    assert done.stdout.split() == [str(int(signal.SIGKILL))] * 3, done.stderr
    for number in range(3):
        folder = cache / str(number)
        monkeypatch.setenv("ATLAS_CACHE", str(folder))
        assert len(machine_code.cached()) == number
        module = fresh(SHIFTED)
        assert module.integrate(3.0) == 7.0
        assert sum(module.shifted.stats.cache_hits.values()) == (number > 1)
        assert [path.name for path in folder.iterdir() if path.name.startswith(".")] == []
        assert len(machine_code.cached()) == 3
    assert caplog.messages == []


@pytest.mark.long
def test_processes_that_compile_at_once_all_succeed(cache):
    code = f"from atlas.kernel import machine_code; print(machine_code.load({SOURCE!r}).integrate(1.0))"
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        for _ in range(2)
    ]
    assert [process.communicate() for process in processes] == [("2.0\n", "")] * 2
    assert len(list(cache.iterdir())) == 1


def test_cache_is_listed_and_cleared(cache):
    assert fresh(SOURCE).integrate(1.0) == 2.0
    (file,) = cache.iterdir()
    earlier = cache / "atlas_kernel_of_an_earlier_version"
    earlier.mkdir()
    (earlier / "kernel.py").write_text("1234")
    ended = re.sub(r"-\d+-\d+$", "-4000000-1", files.process_name())
    (cache / f".atlas-{ended}-00000000.tmp").write_text("left by a process that was killed")
    (cache / "mine.txt").write_text("")
    assert machine_code.cached() == {file.name: file.stat().st_size, earlier.name: 4}
    assert machine_code.clear() == 2
    assert machine_code.cached() == {}
    assert [path.name for path in cache.iterdir()] == ["mine.txt"]


@pytest.fixture
def numba_variable(monkeypatch):
    """Function that sets an environment variable of Numba; the settings in effect are restored in the end."""
    with monkeypatch.context() as patched:
        yield patched.setenv
    numba.config.reload_config()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("NUM_THREADS", "1"), ("CACHE_DIR", "/nowhere"), ("CACHE_LOCATOR_CLASSES", "None"), ("DEBUG_CACHE", "1"),
        ("THREADING_LAYER", "workqueue"), ("DISABLE_PERFORMANCE_WARNINGS", "1"), ("FULL_TRACEBACKS", "1"),
        ("OPT", "3"),
    ],
)  # fmt: skip
def test_harmless_variables_of_numba_do_not_change_the_hash(name, value, numba_variable):
    before = machine_code.digest(SOURCE)
    numba_variable(f"NUMBA_{name}", value)
    assert machine_code.digest(SOURCE) == before


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("CPU_NAME", "generic"), ("CPU_FEATURES", "-avx512f"), ("OPT", "1"), ("ENABLE_AVX", "0"),
        ("LOOP_VECTORIZE", "0"), ("SLP_VECTORIZE", "1"), ("BOUNDSCHECK", "1"), ("DISABLE_JIT", "1"),
        ("DEBUGINFO", "1"),
    ],
)  # fmt: skip
def test_variables_of_numba_that_change_machine_code_change_the_hash(name, value, numba_variable):
    before = machine_code.digest(SOURCE)
    numba_variable(f"NUMBA_{name}", value)
    assert machine_code.digest(SOURCE) != before


def test_instructions_of_the_processor_change_the_hash(monkeypatch):
    """Two machines of one processor name may allow other instructions."""
    before, features = machine_code.digest(SOURCE), dict(machine_code.llvm.get_host_cpu_features())
    some = next(name for name, has in features.items() if has)
    monkeypatch.setattr(machine_code.llvm, "get_host_cpu_features", lambda: features | {some: False})
    assert machine_code.digest(SOURCE) != before


def test_the_cache_stays_in_its_folder_whatever_numba_is_told(cache, numba_variable):
    numba_variable("NUMBA_CACHE_DIR", str(cache.parent / "other"))
    assert fresh().integrate(1.0) == 2.0
    assert len(list(cache.iterdir())) == 1
    assert not (cache.parent / "other").exists()


# Runs in a process of its own, before anything of atlas has been imported; its arguments: a kernel to compile, an
# empty cache for it, a point.
COMPARE_BEFORE_AND_AFTER = """
import ast, gc, os, sys

import numba
from numba.core.base import BaseContext


def snapshot():
    alignment = BaseContext.get_preferred_array_alignment
    options = {name: value for name, value in vars(numba.config).items() if name.isupper()}
    return {
        "garbage collection": gc.isenabled(),
        "origin of the array alignment": (alignment.__module__, alignment.__qualname__),
        **{f"BaseContext.{name}": value for name, value in vars(BaseContext).items()},
        **{f"numba.config.{name}": repr(value) for name, value in options.items()},
    }


def changes(when):
    after = snapshot()
    names = sorted({name for name in before | after if before.get(name) != after.get(name)})
    return [f"{when}: {name}: {before.get(name)} -> {after.get(name)}" for name in names]


before = snapshot()
import atlas.kernel.machine_code

source, empty_cache, point = sys.argv[1:]
all_changes = changes("after the import")
usual_cache, os.environ["ATLAS_CACHE"] = os.environ["ATLAS_CACHE"], empty_cache
assert atlas.kernel.machine_code.load(source).integrate(1.0) == 2.0
os.environ["ATLAS_CACHE"] = usual_cache
all_changes += changes("after a compilation")
import atlas

atlas.label_points("satellite", ast.literal_eval(point), duration=1.0, tolerance=1e-4)
print("\\n".join(all_changes + changes("after a run")))
"""


@pytest.mark.long
def test_numba_is_unchanged_by_import_compilation_and_run(tmp_path):
    result = subprocess.run(
        [sys.executable, "-c", COMPARE_BEFORE_AND_AFTER, SOURCE, str(tmp_path), repr(ALL_TERMS)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert result.stdout.strip() == ""
