"""Processors alike: what differs between their machine code changes no bit, and whatever changes bits is compared."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from truth import assert_same_bytes

import atlas
from atlas.kernel import machine_code, specialization
from atlas.runs import processor
from atlas.runs.plan import ScenePlan
from atlas.runs.run import RunFolder
from atlas.systems import SYSTEMS
from atlas.variables import default_variables, is_measured

SIZE = 96
HASWELL = {
    "NUMBA_CPU_NAME": "haswell",
    "NUMBA_CPU_FEATURES": "+avx,+avx2,+bmi,+bmi2,+f16c,+fma,+lzcnt,+movbe,+popcnt,+sse4.1,+sse4.2",
}
fused = pytest.mark.skipif(
    machine_code.architecture() != "x86_64 with fused multiply-add" or machine_code.cpu() == "haswell",
    reason="needs another processor than haswell that runs its code",
)


def python(code: str, *arguments: object, **variables: str) -> str:
    """What another process prints."""
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)], env=os.environ | variables, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def random_points(system: str) -> dict[str, np.ndarray]:
    """Bodies and starts at which no term of the equations vanishes."""
    generator = np.random.default_rng(7)
    values = {name: generator.uniform(0.2, 0.8, SIZE) for name in SYSTEMS[system].parameters}
    values |= {name: generator.uniform(1.0, 1.9, SIZE) for name in ("A", "B", "C")}
    other = ("R", "M", "lambda", "Omega", "p0", "q0", "r0", "gamma10", "gamma20", "gamma30")
    return {name: value for name, value in values.items() if name not in other}


def statistics(system: str, method: str) -> dict[str, str]:
    """Bits of all statistics of the random points; theory, which would be compiled for minutes, is left out."""
    measured = [name for name in default_variables(SYSTEMS[system]) if is_measured(SYSTEMS[system], name)]
    ds = atlas.label_points(system, random_points(system), duration=10.0, method=method, variables=measured)
    return {str(name): np.ascontiguousarray(values).tobytes().hex() for name, values in ds.variables.items()}


SHORT_VECTORS = r"""
import json, re, sys
sys.path[:0] = "tests/runs", "tests"
from atlas.kernel import intrinsics
intrinsics.VECTOR_BITS = 128
import test_processor
result = test_processor.statistics(*sys.argv[1:])
from atlas.kernel import machine_code
kernels = [m for name, m in sys.modules.items() if name.startswith("atlas_kernel_") and hasattr(m, "integrate")]
(text,) = kernels[0].integrate.inspect_asm().values()
json.dump([result, re.findall(r"vfn?m[a-z]+\d+pd\s.*%([xyz])mm", text)], sys.stdout)
"""


@pytest.mark.long
@fused
@pytest.mark.parametrize(
    ("system", "method"),
    [
        ("fixed_point", "rk4"),
        pytest.param("fixed_point", "rk8", marks=pytest.mark.long),
        pytest.param("satellite", "rk4", marks=pytest.mark.long),
        pytest.param("satellite", "rk8", marks=pytest.mark.long),
    ],
)  # fmt: skip
def test_the_length_of_vectors_changes_no_bit(system, method, tmp_path):
    short, vectors = json.loads(python(SHORT_VECTORS, system, method, ATLAS_CACHE=str(tmp_path)))
    assert set(vectors) == {"x"}
    assert short == statistics(system, method)


@pytest.mark.long
@fused
def test_a_folder_begun_for_a_processor_goes_on_with_another_one_alike(scene_text, tmp_path, monkeypatch):
    monkeypatch.setenv("ATLAS_TILE_POINTS", "16")
    small_scene = scene_text(
        {"outputs.variables": ["theta_dot_rms", "psi_dot_mean", "phi_dot_std", "theta_max"]}
    )
    (tmp_path / "scene.toml").write_text(small_scene)
    begin = "import sys, atlas; atlas.run(sys.argv[1], sys.argv[2], shard=(1, 2), progress=False)"
    cache = tmp_path / "kernels"
    python(begin, tmp_path / "scene.toml", f"{tmp_path}/run/", ATLAS_CACHE=str(cache), **HASWELL)
    run = RunFolder.open(tmp_path / "run")
    begun = run.tiles.written()
    assert 0 < len(begun) < run.tiling.count
    whole = atlas.run(small_scene, f"{tmp_path}/run/", progress=False)
    assert_same_bytes(atlas.run(small_scene, progress=False), whole)
    assert set(whole.attrs["atlas_cpu"].split(", ")) == {"haswell", machine_code.cpu()}

    # Neither loads the machine code of the other.
    plan = ScenePlan.of(atlas.load_scene(small_scene)).runs
    text = specialization.source(plan.system, plan.settings.method, plan.specialization, plan.plugs)
    kernels = [path.name for path in cache.iterdir() if machine_code.is_kernel(path.name)]
    assert kernels
    assert not any(name.startswith(f"atlas_kernel_{machine_code.digest(text)}") for name in kernels)


@pytest.mark.parametrize(
    ("name", "features", "expected"),
    [
        ("haswell", "+fma", True),
        ("skylake-avx512", "", True),
        ("nehalem", "", False),
        ("haswell", "-fma", False),
    ],
)
@fused
def test_fused_operations_are_seen_in_machine_code(name, features, expected):
    assert machine_code.fuses(name, features) == expected


@pytest.mark.usual("variables0")
@fused
@pytest.mark.parametrize(
    ("variables", "expected"),
    [
        ({"CPU_NAME": "nehalem", "CPU_FEATURES": "+sse4.2"}, "x86_64"),
        ({"CPU_FEATURES": "-fma"}, "x86_64"),
        ({"CPU_NAME": "skylake-avx512", "CPU_FEATURES": "+avx512f"}, "x86_64 with fused multiply-add"),
    ],
)
def test_the_architecture_of_a_setting_says_whether_operations_are_fused(variables, expected):
    code = "from atlas.kernel import machine_code; print(machine_code.architecture())"
    assert python(code, **{f"NUMBA_{name}": value for name, value in variables.items()}).strip() == expected


BITS = "from atlas.runs.processor import library_bits; print(library_bits())"


def test_library_bits_are_the_same_in_each_process_and_at_any_address():
    expected = processor.library_bits()
    kept = []
    for size in (1, 8, 100, 5000):
        kept.append(bytearray(size))
        processor.library_bits.cache_clear()
        assert processor.library_bits() == expected
    assert python(BITS, OPENBLAS_NUM_THREADS="3").strip() == expected


@pytest.mark.usual("OPENBLAS_CORETYPE")
@fused
@pytest.mark.parametrize(
    "variables",
    [
        {"OPENBLAS_CORETYPE": "Prescott"},
        {
            "NPY_DISABLE_CPU_FEATURES": " ".join(
                np.show_config(mode="dicts")["SIMD Extensions"].get("found", ())
            )
        },
    ],
    ids=lambda variables: next(iter(variables)),
)
def test_library_bits_see_other_code_of_numpy_and_of_linear_algebra(variables):
    assert python(BITS, **variables).strip() != processor.library_bits()
