"""The cache of compiled kernels, and Numba as other libraries of the process see it."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import atlas
from atlas.engine import jit


def test_an_edited_line_is_never_answered_by_a_stale_kernel(tmp_path):
    """A copy of the package, one sign of the right-hand side edited: the result must change; a comment must not."""
    shutil.copytree(
        Path(atlas.__file__).parent, tmp_path / "atlas", ignore=shutil.ignore_patterns("__pycache__")
    )
    code = (
        "import atlas; from atlas.engine.specialization import kernel_hash; from atlas.systems import SYSTEMS\n"
        "ds = atlas.label_points('satellite', dict(theta0=0.4, n=0.3, k3=0.2), duration=5.0, tolerance=1e-6)\n"
        "print(kernel_hash(SYSTEMS['satellite'], 'rk4'), float(ds.theta_dot_rms[0]).hex())"
    )

    def result() -> list[str]:
        done = subprocess.run(
            [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True,
            env={"PATH": "", "ATLAS_CACHE": str(tmp_path / "cache"), "HOME": str(tmp_path)},
        )  # fmt: skip
        return done.stdout.split()

    path = tmp_path / "atlas" / "systems" / "satellite" / "equations.py"
    original = path.read_text()
    first = result()
    assert result() == first
    path.write_text(original.replace("H1, H2, H3 =", "# a comment\n    H1, H2, H3 =", 1))
    assert result() == first
    edited = original.replace("- N * D1 * a2 * a3", "+ N * D1 * a2 * a3", 1)
    assert edited != original
    path.write_text(edited)
    changed = result()
    assert changed[0] != first[0]
    assert changed[1] != first[1]


def test_cache_that_cannot_be_written_compiles_in_memory(tmp_path, monkeypatch):
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv("ATLAS_CACHE", str(blocked))
    source = jit.HEADER + "\n\n" + jit.KERNEL + "\ndef integrate(x):\n    return x + 1.0\n"
    with pytest.warns(UserWarning, match="compiling in memory"):
        module = jit.load(source)
    assert module.integrate(1.0) == 2.0


def test_cache_is_listed_and_cleared(tmp_path, monkeypatch):
    monkeypatch.setenv("ATLAS_CACHE", str(tmp_path / "kernels"))
    source = jit.HEADER + "\n\n" + jit.KERNEL + "\ndef integrate(x):\n    return x + 2.0\n"
    assert jit.load(source).integrate(1.0) == 3.0
    assert len(jit.cached()) == 1
    assert jit.clear() == 1
    assert jit.cached() == []


# Runs in a process of its own, before anything of atlas has been imported.
COMPARE_BEFORE_AND_AFTER = """
import numba
from numba.core.base import BaseContext


def snapshot():
    alignment = BaseContext.get_preferred_array_alignment
    options = {name: value for name, value in vars(numba.config).items() if name.isupper()}
    return {
        "origin of the array alignment": (alignment.__module__, alignment.__qualname__),
        **{f"BaseContext.{name}": value for name, value in vars(BaseContext).items()},
        **{f"numba.config.{name}": repr(value) for name, value in options.items()},
    }


def changes(when):
    after = snapshot()
    names = sorted({name for name in before | after if before.get(name) != after.get(name)})
    return [f"{when}: {name}: {before.get(name)} -> {after.get(name)}" for name in names]


before = snapshot()
import atlas.engine.jit

after_import = changes("after the import")
import atlas

atlas.label_points("satellite", {"theta0": [0.4]}, duration=1.0, tolerance=1e-4)
print("\\n".join(after_import + changes("after a run")))
"""


def test_numba_is_unchanged_by_import_and_by_a_run():
    result = subprocess.run(
        [sys.executable, "-c", COMPARE_BEFORE_AND_AFTER], capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    assert result.stdout.strip() == ""
