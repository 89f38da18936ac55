"""The width and depth of source trees: `python -m benchmarks.structure [FOLDER ...] [--names]`.

A column for each tree, so that before and after stand side by side.

**Conventions.** Modules are the Python files in top-level folders and the TypeScript files of the pages. `tests` and
`testing` are counted apart; every figure below the counts is of the code without them. A folder is as wide as it has
modules of one language in it, not below it. Hops are imports on the shortest way (`benchmarks.import_graph`): to SQL is
to a module that imports a statement of SQLAlchemy, to a kernel to one that imports a compiler of numba.
"""

import argparse
import ast
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import mean, median

from rich.console import Console
from rich.table import Table

from benchmarks.import_graph import ImportGraph, cycles, hops, imported_names, read_import_graph, source_files

TESTS = {"tests", "testing"}
WIDE, TOO_WIDE = 20, 30
SMALL_LINES = 40
STATEMENTS = {f"sqlalchemy.{name}" for name in ("select", "insert", "update", "delete")}
COMPILED = {"numba.njit", "numba.jit", "numba.vectorize", "numba.guvectorize"}
ROUTES, COMMAND = "api.routes.", "label.py"


@dataclass(frozen=True)
class Tree:
    """The modules of a tree: code, tests and pages, each with its text; the syntax and import graph of the code."""

    root: Path
    code: Mapping[Path, str]
    tests: Mapping[Path, str]
    pages: Mapping[Path, str]
    syntax: Mapping[Path, ast.Module]
    graph: ImportGraph


@dataclass(frozen=True)
class Width:
    """How many modules there are and how crowded their folders."""

    files: int
    lines: int
    wide: int
    too_wide: int
    crowded_ratio: float
    siblings: float


@dataclass(frozen=True)
class Hops:
    """The nearest, the mean and the farthest of some shortest ways; how many ways there are."""

    nearest: int
    mean: float
    farthest: int
    ways: int

    def __str__(self) -> str:
        return f"{self.mean:.1f} ({self.nearest}–{self.farthest}, {self.ways} ways)"


def read_tree(root: Path) -> Tree:
    texts = {path: path.read_text("utf-8") for path in source_files(root)}
    tests = {path: text for path, text in texts.items() if path.relative_to(root).parts[0] in TESTS}
    code = {path: text for path, text in texts.items() if path not in tests}
    pages = {path: path.read_text("utf-8") for path in source_files(root, ".ts")}
    graph = read_import_graph(root)
    files = {name: path for name, path in graph.files.items() if path in code}
    imports = {name: frozenset(one for one in graph.imports[name] if one in files) for name in files}
    syntax = {path: ast.parse(text) for path, text in code.items()}
    return Tree(root, code, tests, pages, syntax, ImportGraph(files, imports))


def width(texts: Mapping[Path, str]) -> Width:
    folders = Counter(path.parent for path in texts)
    siblings = [folders[path.parent] for path in texts]
    return Width(
        files=len(texts),
        lines=sum(len(text.splitlines()) for text in texts.values()),
        wide=sum(count > WIDE for count in folders.values()),
        too_wide=sum(count > TOO_WIDE for count in folders.values()),
        crowded_ratio=sum(count > WIDE for count in siblings) / max(len(siblings), 1),
        siblings=median(siblings) if siblings else 0.0,
    )


def public_names(tree: Tree) -> int:
    """Classes, functions and values at the top of modules whose names begin with no underscore."""
    return sum(not name.startswith("_") for module in tree.syntax.values() for name in _top_names(module))


def repeated_classes(tree: Tree) -> dict[str, list[str]]:
    """Names that more than one class has, and the files of these."""
    found: dict[str, list[str]] = defaultdict(list)
    for path, module in tree.syntax.items():
        for node in ast.walk(module):
            if isinstance(node, ast.ClassDef):
                found[node.name].append(str(path.relative_to(tree.root)))
    return {name: files for name, files in sorted(found.items()) if len(files) > 1}


def small_with_one_importer(tree: Tree) -> list[str]:
    """Modules of few lines that one other module imports, and none besides: pieces of that one."""
    return sorted(
        name
        for name, path in tree.graph.files.items()
        if not _is_package(tree, name)
        and len(tree.code[path].splitlines()) < SMALL_LINES
        and len(tree.graph.importers[name]) == 1
    )


def hops_to_sql(tree: Tree) -> Hops | None:
    """From each route module to the nearest module that makes a statement."""
    targets = {name for name, path in tree.graph.files.items() if imported_names(tree.syntax[path]) & STATEMENTS}
    routes = [name for name in tree.graph.files if name.startswith(ROUTES) and not _is_package(tree, name)]
    ways = (min(_ways(tree, route, targets), default=None) for route in routes)
    return _hops([way for way in ways if way is not None])


def hops_to_kernels(tree: Tree) -> Hops | None:
    """From the module of `stone label` to every module with a compiled function that it reaches."""
    kernels = {name for name, path in tree.graph.files.items() if imported_names(tree.syntax[path]) & COMPILED}
    commands = [name for name, path in tree.graph.files.items() if "commands" in path.parts and path.name == COMMAND]
    return _hops([way for command in commands for way in _ways(tree, command, kernels)])


def rows(tree: Tree) -> Iterator[tuple[str, str]]:
    """The table of a tree: what is measured, and how much it is."""
    for kind, texts in (("code", tree.code), ("tests", tree.tests), ("pages, TypeScript", tree.pages)):
        found = width(texts)
        yield f"{kind}: files", f"{found.files:,}"
        yield f"{kind}: lines", f"{found.lines:,}"
        yield f"{kind}: folders > {WIDE}", str(found.wide)
        yield f"{kind}: folders > {TOO_WIDE}", str(found.too_wide)
        yield f"{kind}: files in folders > {WIDE}", f"{found.crowded_ratio:.0%}"
        yield f"{kind}: siblings of a file, median", f"{found.siblings:g}"
    yield "public names", f"{public_names(tree):,}"
    repeated = repeated_classes(tree)
    yield "class names used twice or more", f"{len(repeated)} ({sum(map(len, repeated.values()))} classes)"
    found_cycles = cycles(tree.graph.imports)
    yield "import cycles, local imports included", f"{len(found_cycles)} ({sum(map(len, found_cycles))} modules)"
    yield f"modules < {SMALL_LINES} lines with one importer", str(len(small_with_one_importer(tree)))
    yield "hops from a route to SQL, mean", str(hops_to_sql(tree) or "none")
    yield "hops from `stone label` to the kernels, mean", str(hops_to_kernels(tree) or "none")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="*", default=[Path()])
    parser.add_argument("--names", action="store_true", help="also wide folders, cycles and repeated names one by one")
    options = parser.parse_args()
    trees = [read_tree(folder.resolve()) for folder in options.folders]
    console = Console(width=160)
    table = Table("", *(str(folder) for folder in options.folders))
    for row in zip(*(list(rows(tree)) for tree in trees), strict=True):
        table.add_row(row[0][0], *(value for _, value in row))
    console.print(table)
    if options.names:
        for tree in trees:
            console.print("\n".join(named(tree)), markup=False, highlight=False, soft_wrap=True)


def named(tree: Tree) -> Iterator[str]:
    """The findings of a tree one by one, a line each."""
    for texts in (tree.code, tree.tests, tree.pages):
        for folder, count in Counter(path.parent for path in texts).most_common():
            if count > WIDE:
                yield f"folder of {count}: {folder.relative_to(tree.root)}"
    yield from (f"cycle: {' '.join(group)}" for group in cycles(tree.graph.imports))
    yield from (f"class {name}: {' '.join(files)}" for name, files in repeated_classes(tree).items())
    yield from (f"small, one importer: {name}" for name in small_with_one_importer(tree))


def _top_names(module: ast.Module) -> Iterator[str]:
    for node in module.body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield node.name
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = (name for target in targets for name in ast.walk(target))
            yield from (name.id for name in names if isinstance(name, ast.Name) and isinstance(name.ctx, ast.Store))


def _is_package(tree: Tree, name: str) -> bool:
    return tree.graph.files[name].name == "__init__.py"


def _ways(tree: Tree, start: str, targets: set[str]) -> list[int]:
    return [way for name, way in hops(tree.graph.imports, start).items() if name in targets]


def _hops(ways: Sequence[int]) -> Hops | None:
    return Hops(min(ways), mean(ways), max(ways), len(ways)) if ways else None


if __name__ == "__main__":
    main()
