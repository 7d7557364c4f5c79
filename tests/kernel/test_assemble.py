"""The text of a compiled kernel."""

import ast

import pytest

from atlas.kernel import assemble, machine_code
from atlas.kernel import integrate as kernel
from atlas.kernel.tableaux import METHODS
from atlas.systems import SYSTEMS, arithmetic


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("system", SYSTEMS.values(), ids=lambda system: system.name)
def test_the_kernel_holds_every_function_once(system, method):
    tree = ast.parse(assemble.source(system.equations, method))
    names = [node.name for node in tree.body if isinstance(node, ast.FunctionDef)]
    assert len(set(names)) == len(names)
    assert {"rhs", "step", "integrate", *system.equations.INTEGRALS, *arithmetic.functions(kernel)} <= set(
        names
    )


def test_the_key_of_a_kernel_ignores_layout_and_comments():
    source = assemble.source(SYSTEMS["satellite"].equations, "rk4")
    assert machine_code.digest(source) == machine_code.digest(source.replace("\n\n", "\n\n# note\n"))
    assert machine_code.digest(source) != machine_code.digest(
        source.replace("a2 * u3 - a3 * u2", "a2 * u3 + a3 * u2")
    )
