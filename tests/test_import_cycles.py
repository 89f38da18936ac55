"""No module of the project imports itself by way of others, wherever in a file the import stands."""

import ast
from collections.abc import Iterator, Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

from tests.test_architecture import PACKAGES, ROOT

TREES = (*PACKAGES, "chaos", "fuzz", "docsite", "benchmarks", "deploy", "examples")


def modules_below(root: Path, trees: tuple[str, ...] = TREES) -> Mapping[str, Path]:
    """Every module's file by its dotted name; a package goes by its own name."""
    found = {}
    for path in (path for tree in trees for path in (root / tree).rglob("*.py") if "node_modules" not in path.parts):
        parts = path.relative_to(root).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imported_by(node: ast.AST) -> Iterator[str]:
    """The dotted names of all import statements, within functions too; not those for the type checker alone."""
    if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
        for otherwise in node.orelse:
            yield from imported_by(otherwise)
        return
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        yield from (f"{node.module}.{alias.name}" for alias in node.names)
    for child in ast.iter_child_nodes(node):
        yield from imported_by(child)


def import_graph(modules: Mapping[str, Path]) -> dict[str, set[str]]:
    """The modules of the project that each imports: what is imported from one is no module but a name in it."""
    return {
        name: {
            found
            for whole in imported_by(ast.parse(path.read_text("utf-8")))
            for found in (whole if whole in modules else whole.rpartition(".")[0],)
            if found in modules
        }
        for name, path in modules.items()
    }


def cycle_in(graph: Mapping[str, set[str]]) -> list[str]:
    """A way from a module back to itself, each imported by the next; empty where there is none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        found: list[str] = error.args[1]
        return found
    return []


@pytest.mark.whole
def test_no_module_imports_itself_by_way_of_others() -> None:
    modules = modules_below(ROOT)
    assert len(modules) > 500
    cycle = cycle_in(import_graph(modules))
    assert not cycle, "each is imported by the next: " + " → ".join(cycle)


@pytest.mark.parametrize(
    ("line", "cycle"),
    [
        ("from pack import one", True),
        ("import pack.one", True),
        ("from pack.one import name", True),
        ("def late():\n    from pack.one import name", True),
        ("from pack import name", False),
        ("from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from pack import one", False),
    ],
)
def test_a_cycle_is_noticed_wherever_it_stands(tmp_path: Path, line: str, cycle: bool) -> None:
    (tmp_path / "pack").mkdir()
    for name, source in (("__init__", "name = 1"), ("one", "from pack.two import name"), ("two", line)):
        (tmp_path / "pack" / f"{name}.py").write_text(source)
    found = cycle_in(import_graph(modules_below(tmp_path, ("pack",))))
    assert set(found) == ({"pack.one", "pack.two"} if cycle else set())
