"""Functions that fit on a screen: none has more than sixty lines."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MOST = 60


@pytest.mark.parametrize("folder", ["sfgs_jax", "experiments", "benchmarks", "examples", "tests"])
def test_no_function_has_more_than_sixty_lines(folder):
    lengths = {
        f"{path.relative_to(ROOT)}: {node.name}": (node.end_lineno or node.lineno) - node.lineno + 1
        for path in (ROOT / folder).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    }
    assert lengths
    assert {name: length for name, length in lengths.items() if length > MOST} == {}
