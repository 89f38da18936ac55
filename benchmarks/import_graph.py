"""The import graph of a source tree: every first-party module, and which others it imports.

**Conventions.** Read from the syntax, so nothing is imported. Packages are the top-level folders with Python files
below them. An import inside a function counts, one under `if TYPE_CHECKING` does not; that importing `a.b` also runs
`a/__init__.py` does not count either. Hops are modules on the way: 0 from a module to itself.
"""

import ast
from collections import deque
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

LEFT_OUT = {"node_modules", "build", "dist", "__pycache__"}


@dataclass(frozen=True)
class ImportGraph:
    """Modules by dotted name with the file of each, and the modules that each imports."""

    files: Mapping[str, Path]
    imports: Mapping[str, frozenset[str]]

    @cached_property
    def importers(self) -> dict[str, set[str]]:
        found: dict[str, set[str]] = {name: set() for name in self.files}
        for name, targets in self.imports.items():
            for target in targets:
                found[target].add(name)
        return found


def source_files(root: Path, suffix: str = ".py") -> list[Path]:
    """The files in the top-level folders of a tree, sorted, without what is built or installed there."""
    return sorted(
        path
        for path in root.glob(f"*/**/*{suffix}")
        if not any(part in LEFT_OUT or part.startswith(".") for part in path.relative_to(root).parts)
    )


def module_name(root: Path, path: Path) -> str:
    """`a.b` of `a/b.py` and of `a/b/__init__.py`."""
    parts = path.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def read_import_graph(root: Path) -> ImportGraph:
    files = {module_name(root, path): path for path in source_files(root)}
    named = {name: imported_names(ast.parse(path.read_text("utf-8"))) for name, path in files.items()}
    imports = {name: frozenset(_resolved(said, files)) - {name} for name, said in named.items()}
    return ImportGraph(files, imports)


def imported_names(tree: ast.AST) -> set[str]:
    """Dotted names that are imported at run time; `from a import b` is `a.b`, a module or a name in one."""
    found: set[str] = set()
    for node in _run_time_nodes(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def hops(graph: Mapping[str, Collection[str]], start: str) -> dict[str, int]:
    """The shortest way from `start` to every module that it reaches, in imports."""
    found, waiting = {start: 0}, deque([start])
    while waiting:
        name = waiting.popleft()
        for target in sorted(graph.get(name, ())):
            if target not in found:
                found[target] = found[name] + 1
                waiting.append(target)
    return found


def cycles(graph: Mapping[str, Collection[str]]) -> list[list[str]]:
    """The sets of two modules and more that reach each other, each sorted."""
    reached = {name: hops(graph, name).keys() for name in graph}
    groups = {tuple(sorted(other for other in reached[name] if name in reached[other])) for name in graph}
    return sorted(list(group) for group in groups if len(group) > 1)


def _run_time_nodes(tree: ast.AST) -> Iterator[ast.AST]:
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            yield from (inner for kept in node.orelse for inner in (kept, *_run_time_nodes(kept)))
        else:
            yield node
            yield from _run_time_nodes(node)


def _resolved(names: Collection[str], files: Mapping[str, Path]) -> Iterator[str]:
    for name in names:
        for candidate in (name, name.rpartition(".")[0]):
            if candidate in files:
                yield candidate
                break
