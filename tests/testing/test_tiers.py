"""What `make check` leaves out says what it alone would catch."""

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FILES = sorted((ROOT / "tests").rglob("test_*.py"))
MARK = "pytest.mark.release"


def test_what_says_that_it_costs_much_says_what_it_alone_would_catch() -> None:
    found = []
    for path in FILES:
        tree = ast.parse(path.read_text("utf-8"))
        if "Catches alone" not in (ast.get_docstring(tree) or ""):
            found += [f"{path.relative_to(ROOT)}: {name}" for name in silent(tree)]
    assert found == []


def silent(tree: ast.Module) -> Iterator[str]:
    """What is marked in this module and does not say it, by the name of the test, or `pytestmark`."""
    for node in tree.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.value) == MARK:
            yield ast.unparse(node.targets[0])
        elif isinstance(node, ast.FunctionDef) and MARK in map(ast.unparse, node.decorator_list):
            yield from [] if "Catches alone" in (ast.get_docstring(node) or "") else [node.name]
