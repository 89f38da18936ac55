"""Digests of the code that computes results: for each kind of result, all code that its computation can reach.

**Conventions.** A digest covers the definitions that the entries of a kind reach by name, code that runs when their
modules are imported, and the data files that they read. It depends on computations only. Comments, docstrings, names of
local variables, of definitions and of files do not matter, nor does the position of a definition. Libraries are not
read: their versions count (`services/runtime/code_version.py`). Standard library only: the build of a wheel computes
digests before anything is installed (`deploy/images/digests_hook.py`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from types import MappingProxyType
from typing import Literal, NamedTuple

from services.runtime.source_syntax import Computation, computation_of
from services.runtime.source_tree import EFFECTS, Definition, SourceTree, place_of, source_files

ResultKind = Literal["labels", "imports", "exports", "scores", "comparisons"]
ENTRIES: Mapping[ResultKind, tuple[str, ...]] = MappingProxyType(
    {
        "labels": (
            "services.ingest.sandboxed_synchronisation:synchronise_bags",
            "services.ingest.sandboxed_synchronisation:check_left",
            "services.labeler.sandboxed_run:planned",
            "services.labeler.sandboxed_run:worked",
            "services.labeler.sandboxed_run:described",
            "services.labeler.map.refinement:refined",
        ),
        "imports": (
            "services.labeler.imports.indexing:index_dataset",
            "services.labeler.imports.scene_import:import_scene",
        ),
        "exports": (
            "services.labeler.exports.sandboxed_export:write_format",
            "services.labeler.exports.folder:join",
            "services.labeler.exports.folder:rearrange",
        ),
        "scores": (
            "services.eval.pipeline:score",
            "services.eval.examination:count_submission",
            "services.eval.examination:unpacked",
            "services.eval.spectra_file:spectra_npz",
        ),
        "comparisons": (
            "services.eval.comparison.stage:count_pairs",
            "services.eval.comparison.record:comparison_record",
        ),
    }
)
"""The functions that compute each kind of result, as `module:function`.

`labels` are label sets and their synchronised sequences; `imports` are label sets of published datasets.
"""
CODE_SUFFIXES = frozenset({".py", ".md"})
"""The suffixes of code and of documents about it; all other files are data."""
ROOTS = (
    *("stone", "stone_base", "stone_datasets", "stone_exports", "stone_files", "stone_recordings", "stone_submissions"),
    "services",
)
OUTSIDE = ("services.runtime",)
"""Packages that transport results (database, store, queue, sandbox) and compute none: they are not read."""
LIBRARIES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "cramjam": ("cramjam",),
        "deflate": ("deflate",),
        "foxglove": ("foxglove-sdk",),
        "isal": ("isal",),
        "kiss_icp": ("kiss-icp",),
        "lz4": ("lz4",),
        "numba": ("numba", "llvmlite"),
        "numpy": ("numpy",),
        "open3d": ("open3d-cpu",),
        "pymap3d": ("pymap3d",),
        "rerun": ("rerun-sdk",),
        "rosbags": ("rosbags",),
        "ruamel": ("ruamel-yaml",),
        "scipy": ("scipy",),
        "small_gicp": ("small-gicp",),
        "zstandard": ("zstandard",),
    }
)
"""The distributions whose versions count, by imported package: they calculate, or decode inputs."""
NEUTRAL_LIBRARIES = frozenset({"PIL", "av", "llvmlite", "matplotlib", "pyarrow", "pydantic"})
"""Packages whose versions do not count: they draw, write tables or check values; llvmlite counts with numba."""


class SourceDigest(NamedTuple):
    """The digest of the code of one kind of result, and the version of each library that counts, "" if not fixed."""

    sha256: str
    libraries: Mapping[str, str]


Digests = Mapping[ResultKind, SourceDigest]


@dataclass
class Reach:
    """The definitions that entries reach, each with its computation, and the modules that are imported for them.

    `known` contains computations of the same tree; several reaches share them.
    """

    tree: SourceTree
    known: dict[Definition, Computation] = field(default_factory=dict)
    computations: dict[Definition, Computation] = field(default_factory=dict)
    loaded: set[str] = field(default_factory=set)

    def add(self, entries: Sequence[Definition]) -> None:
        """Follow all references from these definitions. Raises `unresolved_name`, `sources_missing`."""
        todo = [*entries, *(effect for entry in entries for effect in self._load(entry.module))]
        while todo:
            definition = todo.pop()
            if definition in self.computations:
                continue
            if definition not in self.known:
                self.known[definition] = computation_of(self.tree, definition)
            made = self.computations[definition] = self.known[definition]
            todo += made.references
            todo += (effect for module in sorted(made.loaded) for effect in self._load(module))

    def _load(self, name: str) -> list[Definition]:
        """Return the effects of importing a module: its own, and those of its packages and of its imports."""
        effects, todo = list[Definition](), [name]
        while todo:
            module = todo.pop()
            if module in self.loaded or not self.tree.is_inside(module) or self.tree.path_of(module) is None:
                continue
            self.loaded.add(module)
            parsed = self.tree.module(module)
            if EFFECTS in parsed.statements:
                effects.append(Definition(module, EFFECTS))
            todo += [*parsed.loaded, module.rpartition(".")[0]]
        return effects

    @property
    def libraries(self) -> set[str]:
        """Return the top-level packages of other projects that the computations refer to."""
        return {library for made in self.computations.values() for library in made.libraries if library}

    def digest(self) -> str:
        """Return the sha256 over all computations and data files; equal ones count once."""
        labels = _refined({definition: (made.text, made.references) for definition, made in self.computations.items()})
        data = (
            line for definition, made in self.computations.items() for line in self._data(definition.module, made.data)
        )
        return sha256("\n".join(sorted({*labels.values(), *data})).encode()).hexdigest()

    def _data(self, module: str, packages: set[str]) -> list[str]:
        """Return a line for each data file below these packages; "" is the module's own package."""
        lines = list[str]()
        for path in (self.tree.path_of(package or module) for package in packages):
            for name, file in source_files(path.parent) if path is not None else ():
                if file.suffix not in CODE_SUFFIXES:
                    lines.append(f"data {name} {sha256(file.read_bytes()).hexdigest()}")
        return lines


def _refined(computations: Mapping[Definition, tuple[str, Sequence[Definition]]]) -> dict[Definition, str]:
    """Return a label for each definition that covers its text and, in order, the labels of its references.

    References may be circular, so labels are refined until they distinguish no more definitions (colour refinement).
    """
    texts = {definition: sha256(text.encode()).hexdigest() for definition, (text, _) in computations.items()}
    labels, distinct = texts, 0
    while len(set(labels.values())) > distinct:
        distinct = len(set(labels.values()))
        labels = {
            definition: sha256(
                " ".join([texts[definition], *(labels[other] for other in references)]).encode()
            ).hexdigest()
            for definition, (_, references) in computations.items()
        }
    return labels


def record_of(digests: Digests) -> dict[str, dict[str, object]]:
    """Return the digests as plain JSON values, which `services/runtime/code_version.py` reads."""
    return {kind: {"sha256": digest.sha256, "libraries": dict(digest.libraries)} for kind, digest in digests.items()}


def reaches(places: Mapping[str, Path]) -> dict[ResultKind, Reach]:
    """Return the reach of each kind of result, by the folder of each of `ROOTS`.

    Raises `unresolved_name`, `sources_missing`.
    """
    tree, known = SourceTree(places, OUTSIDE), dict[Definition, Computation]()
    by_kind = {kind: Reach(tree, known) for kind in ENTRIES}
    for kind, reach in by_kind.items():
        reach.add([Definition(*entry.split(":")) for entry in ENTRIES[kind]])
    return by_kind


def installed_places() -> dict[str, Path]:
    """Return the folders of the packages that this process imports. Raises `sources_missing`."""
    return {root: place_of(root) for root in ROOTS}


def source_digests(places: Mapping[str, Path]) -> Digests:
    """Return the digest of every kind of result, by the folder of each of `ROOTS`.

    Raises `unresolved_name`, `sources_missing`.
    """
    digests = dict[ResultKind, SourceDigest]()
    for kind, reach in reaches(places).items():
        named = {name for library in reach.libraries for name in LIBRARIES.get(library, ())}
        digests[kind] = SourceDigest(reach.digest(), dict.fromkeys(sorted(named), ""))
    return digests


def sources_sha256(places: Mapping[str, Path]) -> str:
    """Return the sha256 of all source files that a digest may cover, byte by byte."""
    digest = sha256()
    for root, folder in sorted(places.items()):
        for name, path in source_files(folder):
            content = path.read_bytes()
            digest.update(f"{root}/{name}\0{len(content)}\0".encode())
            digest.update(content)
    return digest.hexdigest()
