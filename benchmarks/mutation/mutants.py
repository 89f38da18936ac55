"""Mutants: which faults to put where, drawn from a seed, and how one is found again in a tree that was rearranged.

**Conventions.** A mutant names its place three times: by the text of the expression and its number among equal ones in
the function, by its number among all places of the function, and by the shape of the function. A shape is the syntax
without names, texts and imports, so that a move or a rename keeps it.
"""

import ast
import hashlib
import random
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.import_graph import source_files
from benchmarks.mutation.operators import Place, places_of

NAMES = {"id", "attr", "arg", "name", "names", "module", "asname", "kind", "ctx", "type_comment", "rest"}
SHAPE_LETTERS = 16


@dataclass(frozen=True)
class Mutant:
    """One fault: the place in the tree that it was drawn from, and the text that stands there instead."""

    package: str
    file: str
    line: int
    function: str
    operator: str
    original: str
    mutated: str
    occurrence: int
    ordinal: int
    choice: int
    shape: str
    function_shape: str


@dataclass(frozen=True)
class Source:
    """A file of a tree as text, with the places that may be changed, by function."""

    path: Path
    text: str
    places: Mapping[str, Sequence[Place]]
    shapes: Mapping[str, str]

    def segment(self, place: Place) -> str:
        return ast.get_source_segment(self.text, place.node) or ""


@dataclass(frozen=True)
class Located:
    """A mutant in a tree: the file, and the whole text of it with the fault."""

    path: Path
    line: int
    text: str


def read_source(path: Path) -> Source:
    text = path.read_text("utf-8")
    tree = ast.parse(text)
    places: dict[str, list[Place]] = defaultdict(list)
    for place in places_of(tree):
        places[place.function].append(place)
    return Source(path, text, places, {name: shape_of(node) for name, node in _scopes(tree, "")})


def draw(root: Path, packages: Mapping[str, tuple[Sequence[str], int]], seed: int) -> list[Mutant]:
    """For each package (its folders or files, how many) that many mutants at different places; the same for a seed."""
    rng = random.Random(seed)
    drawn = []
    for package, (folders, count) in packages.items():
        sources = [read_source(path) for path in source_files(root) if _is_below(path.relative_to(root), folders)]
        spots = [(source, place) for source in sources for places in source.places.values() for place in places]
        for source, place in rng.sample(spots, min(count, len(spots))):
            drawn.append(_mutant(package, root, source, place, rng.randrange(len(place.changes))))
    return drawn


def locate(mutant: Mutant, root: Path, moved: Mapping[str, str], sources: Mapping[Path, Source]) -> Located | None:
    """The mutant in the tree at `root`, whose files are `sources`; None where its place is gone or no longer sure.

    `moved` says where files are now (a folder moves what is below it); without it a function is known by its shape.
    """
    home = sources.get(root / new_path(mutant.file, moved))
    place = _in_function(mutant, home) if home else None
    if home and place:
        return _applied(home, place, mutant.choice)
    alike = [
        (one, name) for one in sources.values() for name in one.shapes if one.shapes[name] == mutant.function_shape
    ]
    same = [(one, name) for one, name in alike if one is home] or alike
    if not mutant.function_shape or len(same) != 1:
        return None
    source, name = same[0]
    place = _by_ordinal(mutant, source.places.get(name, ()))
    return _applied(source, place, mutant.choice) if place else None


def new_path(path: str, moved: Mapping[str, str]) -> str:
    """Where a file is now: by its own name, else by the nearest folder above it that moved."""
    for folder in (path, *(str(parent) for parent in Path(path).parents)):
        if folder in moved:
            return moved[folder] + path[len(folder) :]
    return path


def shape_of(node: ast.AST) -> str:
    return hashlib.sha256(_shape(node).encode()).hexdigest()[:SHAPE_LETTERS]


def with_change(text: str, node: ast.expr | ast.stmt, changed: str) -> str:
    """The text with what stands at `node` replaced; columns count bytes."""
    lines = text.encode().split(b"\n")
    assert node.end_lineno is not None  # noqa: S101 (parsed nodes have it)
    before = [*lines[: node.lineno - 1], lines[node.lineno - 1][: node.col_offset]]
    after = [lines[node.end_lineno - 1][node.end_col_offset :], *lines[node.end_lineno :]]
    return (b"\n".join(before) + changed.encode() + b"\n".join(after)).decode()


def _mutant(package: str, root: Path, source: Source, place: Place, choice: int) -> Mutant:
    places = source.places[place.function]
    original = source.segment(place)
    operator, mutated = place.changes[choice]
    equal = [one for one in places if source.segment(one) == original]
    return Mutant(
        package=package,
        file=str(source.path.relative_to(root)),
        line=place.node.lineno,
        function=place.function,
        operator=operator,
        original=original,
        mutated=mutated,
        occurrence=equal.index(place),
        ordinal=places.index(place),
        choice=choice,
        shape=shape_of(place.node),
        function_shape=source.shapes.get(place.function, ""),
    )


def _in_function(mutant: Mutant, source: Source) -> Place | None:
    places = source.places.get(mutant.function, ())
    equal = [place for place in places if source.segment(place) == mutant.original]
    if mutant.occurrence < len(equal) and (mutant.operator, mutant.mutated) in equal[mutant.occurrence].changes:
        return equal[mutant.occurrence]
    return _by_ordinal(mutant, places)


def _by_ordinal(mutant: Mutant, places: Sequence[Place]) -> Place | None:
    if mutant.ordinal < len(places) and shape_of(places[mutant.ordinal].node) == mutant.shape:
        return places[mutant.ordinal]
    return None


def _applied(source: Source, place: Place, choice: int) -> Located:
    text = with_change(source.text, place.node, place.changes[choice][1])
    ast.parse(text)
    return Located(source.path, place.node.lineno, text)


def _scopes(node: ast.AST, within: str) -> Iterator[tuple[str, ast.AST]]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            name = f"{within}.{child.name}" if within else child.name
            yield name, child
            yield from _scopes(child, name)
        else:
            yield from _scopes(child, within)


def _shape(node: object) -> str:
    if isinstance(node, list):
        return ",".join(_shape(one) for one in node)
    if isinstance(node, ast.Import | ast.ImportFrom):
        return ""
    if isinstance(node, ast.AST):
        parts = (_shape(value) for name, value in ast.iter_fields(node) if name not in NAMES)
        return f"{type(node).__name__}({';'.join(parts)})"
    return "text" if isinstance(node, str) else repr(node)


def _is_below(path: Path, folders: Sequence[str]) -> bool:
    return any(path.is_relative_to(folder) for folder in folders)
