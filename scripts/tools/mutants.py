"""Put wrong expressions (mutants) into copies of the package, one at a time, and list which of them the nearest tests kill.

python scripts/tools/mutants.py [SEED [COUNT [SKIP]]] > TABLE     (53 60 0)

Modules are drawn in proportion to their lines. A test kills a mutant if it fails with the mutant and passes without.
"""

import ast
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from itertools import islice
from pathlib import Path
from random import Random

PYTEST = (
    f'ulimit -d 8388608; ulimit -t 240; exec "{sys.executable}" -m pytest -xqrfE --tb=no -m "not faults" "$@"'
)
KERNELS = ".pytest_cache/kernels"  # the default of tests/conftest.py
IGNORED = shutil.ignore_patterns(".git", ".venv", "__pycache__", ".[mr]*_cache", ".hypothesis", "out")
OTHER = {ast.Lt: ast.Gt, ast.LtE: ast.GtE, ast.Eq: ast.NotEq, ast.Add: ast.Sub, ast.Mult: ast.Div}
OTHER |= {"min": "max", "minimum": "maximum", "argmin": "argmax", "any": "all", "sin": "cos", "zeros": "ones"}
OTHER |= {b: a for a, b in OTHER.items()}
SYMMETRIC = {"allclose", "array_equal", "fmax", "fmin", "hypot", "isclose", "isinstance", *OTHER}
MESSAGES = {"BadInput", "cast", "info", "say", "shown", "warn", "warning", "Figure", "legend", "tick_params"}
TEXTS = {ast.List, ast.Set, ast.Tuple, ast.JoinedStr}


def expressions(node):
    """A node and all nodes below it, without messages, types and styles of figures."""
    function = ast.unparse(node.func).split(".")[-1] if isinstance(node, ast.Call) else ""
    generic = ast.unparse(node.value).split(".")[-1] if isinstance(node, ast.Subscript) else ""
    is_fixed = function in MESSAGES or re.fullmatch(r"[A-Z]\w*[a-z]\w*|dict|tuple", generic)
    if not is_fixed and not isinstance(node, ast.Raise | ast.Assert | ast.JoinedStr):
        yield node
        for child in ast.iter_child_nodes(node):
            yield from expressions(child)


def changes(node):
    """Wrong expressions for one node; large and small constants, which are sizes and tolerances, are not changed."""
    match node:
        case ast.BinOp(left, op, right) if type(op) in OTHER and not TEXTS & {type(left), type(right)}:
            return [ast.BinOp(left, OTHER[type(op)](), right), left, right]
        case ast.BoolOp(_, terms) | ast.UnaryOp(ast.USub() | ast.Not(), terms):
            return terms if isinstance(terms, list) else [terms]
        case ast.Compare(left, [op], right) if type(op) in OTHER:
            return [ast.Compare(left, [OTHER[type(op)]()], right)]
        case ast.Constant(value) if type(value) in (int, float) and (value == 0 or 1e-3 < value <= 12):
            return [ast.Constant(value + 1), ast.Constant(abs(value - 1))]
        case ast.Subscript(value, ast.Tuple([first, second, *rest])):
            return [ast.Subscript(value, ast.Tuple([second, first, *rest]))]
        case ast.Call(function, [first, second, *rest], words) if type(first) is type(second):
            is_symmetric = ast.unparse(function).split(".")[-1] in SYMMETRIC
            return [] if is_symmetric else [ast.Call(function, [second, first, *rest], words)]
        case ast.Name() | ast.Attribute() if (name := ast.unparse(node).split(".")[-1]) in OTHER:
            return [ast.Name(ast.unparse(node).removesuffix(name) + OTHER[name])]
    return []


def draw(trees, seed):
    """Endless random sequence of (file, node, text of the node, text of a wrong expression)."""
    rng, lines = Random(seed), [tree.body[-1].end_lineno if tree.body else 0 for tree in trees.values()]
    left = {file: [node for node in expressions(tree) if changes(node)] for file, tree in trees.items()}
    for file in iter(lambda: rng.choices(list(trees), lines)[0], None):
        node = left[file].pop(rng.randrange(len(left[file]))) if left[file] else ast.Pass()
        before, after = ast.unparse(node), ast.unparse(rng.choice(changes(node) or [node]))
        if after != before:
            yield file, node, before, after


def nearest(file, text, tests):
    """The three test files that share most rare words, or words of the path, with a module."""
    own, scores = set(re.findall(r"\w+", text)), {}
    holders = Counter(word for words in tests.values() for word in words)
    for test, words in tests.items():
        shared = sum(1 / holders[word] for word in sorted(words & own))
        in_paths = set(re.split(r"[/_.]", file)) & set(re.split(r"[/_.]", test))
        scores[test] = shared * 3 ** len(in_paths) / len(words) ** 0.5
    return sorted(scores, key=scores.get)[:-4:-1]


def outcome(tree, *arguments):
    """First test that fails, or another outcome; limits: 8 GiB, 240 s of processor time, 1000 s of wall-clock time."""
    variables = os.environ | {"PYTHONPATH": str(tree), "ATLAS_CACHE": str(tree / KERNELS)}
    command = ["sh", "-c", PYTEST, "sh", f"--basetemp={tree}.tests", *arguments]
    try:
        run = subprocess.run(command, cwd=tree, env=variables, capture_output=True, text=True, timeout=1000)
    except subprocess.TimeoutExpired:
        return "timed out"
    failed = re.findall(r"^(?:FAILED|ERROR) ([^\s[]+)", run.stdout, re.M)
    return (failed + ["survived"] * (" passed" in run.stdout) + [f"exit code {run.returncode}"])[0]


def main():
    seed, count, skip = (*map(int, sys.argv[1:]), *(53, 60, 0)[len(sys.argv) - 1 :])
    os.chdir(Path(__file__).resolve().parents[2])
    texts = {str(path): path.read_text() for path in sorted(Path().glob("[at]*s/**/*.py"))}
    trees = {file: ast.parse(text) for file, text in texts.items() if file.startswith("atlas")}
    tests = {file: set(re.findall(r"\w+", text)) for file, text in texts.items() if "/test_" in file}
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        base, tree = Path(folder, "base"), Path(folder, "tree")
        shutil.copytree(".", base, ignore=IGNORED)
        if Path(kernels := os.environ.get("ATLAS_CACHE", KERNELS)).is_dir():
            shutil.copytree(kernels, base / KERNELS, dirs_exist_ok=True)
        for file, node, before, after in islice(draw(trees, seed), skip, skip + count):
            lines = texts[file].encode().splitlines(keepends=True)
            head, tail = lines[: node.lineno], lines[node.end_lineno - 1 :]
            head[-1], tail[0] = head[-1][: node.col_offset], tail[0][node.end_col_offset :]
            shutil.copytree(base, tree, dirs_exist_ok=True)
            (tree / file).write_bytes(b"".join([*head, f"({after})".encode(), *tail]))
            ast.parse((tree / file).read_text())
            result = outcome(tree, *nearest(file, texts[file], tests))
            shutil.rmtree(tree, ignore_errors=True)
            if result.startswith("tests"):
                result = f"killed by {result}, {outcome(base, result)} without"
            print(f"{file}:{node.lineno}:{node.col_offset} | `{before}` | `{after}` | {result}", flush=True)


if __name__ == "__main__":
    main()
