"""Everyday's tests leave out what costs much and nothing else, and what is left out says what it alone would catch.

Catches alone tests that run in neither tier.
"""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

pytestmark = pytest.mark.whole

ROOT = Path(__file__).resolve().parents[2]
FILES = sorted((ROOT / "tests").rglob("test_*.py"))
MARK = "pytest.mark.whole"


def chosen(path: str, *options: str) -> list[str]:
    """The tests of a file that these options leave."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--collect-only", *options, path]
    outcome = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True)
    return [line.partition("::")[2] for line in outcome.stdout.splitlines() if "::" in line]


def test_of_the_journeys_one_is_made_every_day() -> None:
    assert chosen("tests/web/test_journeys.py", "-m", "not whole") == [
        "test_an_engineer_brings_a_recording_and_looks_at_its_labels"
    ]


def test_what_runs_on_two_databases_runs_on_the_embedded_one_every_day() -> None:
    path = "tests/services/runtime/database/test_migrate.py"
    everything, everyday = chosen(path), chosen(path, "-m", "not whole")
    assert everyday
    assert set(everything) - set(everyday) == {name for name in everything if "postgres" in name}


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
