"""Digests of the sources that make results: one sha256 for label sets, one for scores.

**Conventions.** A digest is over names and bytes of the files in the order of their names: it depends on no folder,
date, compiled file or machine. Standard library only, and no metadata of an installed project: the build of a wheel
(`deploy/images/digests_hook.py`) asks for them where nothing is installed yet.
"""

from collections.abc import Iterator, Mapping
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType
from typing import Literal

from stone_base.errors import StoneError

ResultKind = Literal["labels", "scores"]
SOURCES: Mapping[ResultKind, tuple[str, ...]] = MappingProxyType(
    {
        "labels": (
            "stone",
            "stone_base",
            "stone_datasets",
            "stone_exports",
            "stone_files",
            "stone_recordings",
            "services.domain.viewer",
            "services.ingest",
            "services.labeler",
        ),
        "scores": ("stone", "stone_base", "stone_files", "stone_submissions", "services.eval"),
    }
)
"""The packages, or single modules, whose code decides the bytes of each kind of result.

`labels` are label sets and whatever is made of them or on the way to them: synchronised sequences, exports, ground
truths, versions of a dataset.
"""
SUFFIXES = frozenset({".py", ".msg"})
"""Of the files that decide a result: code, and the definitions by which messages are decoded."""


class SourcesMissingError(StoneError):
    """A package that makes results has no source files here."""

    code = "sources_missing"

    def __init__(self, name: str) -> None:
        super().__init__(
            f"no source file of {name} can be found, so what it makes has no version; was it installed without sources?"
        )


def source_digests() -> dict[ResultKind, str]:
    """The digest of every kind of result, of the sources that this process imports. Raises `SourcesMissingError`."""
    return {kind: digest_of({name: place_of(name) for name in names}) for kind, names in SOURCES.items()}


def place_of(name: str) -> Path:
    """The folder of a package, the file of a module; nothing of it is run. Raises `SourcesMissingError`."""
    try:
        spec = find_spec(name)
    except ModuleNotFoundError:  # the package it should be in
        spec = None
    if spec is None or spec.origin is None:
        raise SourcesMissingError(name)
    return Path(spec.origin).parent if spec.submodule_search_locations else Path(spec.origin)


def digest_of(places: Mapping[str, Path]) -> str:
    """sha256 of the source files of packages and modules by name. Raises `SourcesMissingError`."""
    digest = sha256()
    for name, place in sorted(places.items()):
        files = sorted(_files(place))
        if not files:
            raise SourcesMissingError(name)
        for relative, path in files:
            content = path.read_bytes()
            digest.update(f"{name}/{relative}\0{len(content)}\0".encode())
            digest.update(content)
    return digest.hexdigest()


def _files(place: Path) -> Iterator[tuple[str, Path]]:
    """The name of each file below a package's folder, or of the one module, and where it is."""
    if place.is_file():
        yield place.name, place
        return
    for path in place.rglob("*"):
        if path.suffix in SUFFIXES and path.is_file():
            yield path.relative_to(place).as_posix(), path
