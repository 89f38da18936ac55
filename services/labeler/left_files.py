"""Files written by children for publication, as seen by the parent: with valid object names, and without links."""

from dataclasses import dataclass
from pathlib import Path

from services.labeler.child_answers import PackAnswer
from services.labeler.label_rows import LABELS, MEDIA_TYPES, OTHER_TYPE
from services.runtime.sandbox import SandboxCrashedError
from services.runtime.store.keys import checked


@dataclass(frozen=True)
class LeftFile:
    """A file to publish; `name` is its artefact's. For a pack, `pack` locates its frames."""

    name: str
    media_type: str
    path: Path
    pack: PackAnswer | None = None


def left_file(name: str, path: Path) -> LeftFile:
    return LeftFile(name, MEDIA_TYPES.get(path.suffix, OTHER_TYPE), path)


def files_left(folder: Path) -> list[LeftFile]:
    """Return every file in the folder in the order of names, except unfinished ones.

    Raises `bad_key` for a name that no object can have.
    """
    paths = sorted(path for path in folder.rglob("[!.]*") if path.is_file() and not path.is_symlink())
    for path in paths:
        checked(path.relative_to(folder.parent).as_posix())
    return [left_file(path.relative_to(folder).as_posix(), path) for path in paths]


def pack_left(path: Path, pack: PackAnswer) -> LeftFile:
    """Return a pack of labels. Raises `SandboxCrashedError` if its length differs from the answer."""
    size_bytes = path.stat().st_size
    if size_bytes != pack.size_bytes:
        raise SandboxCrashedError(f"reported {pack.size_bytes} bytes of {pack.name}, which has {size_bytes}")
    return LeftFile(f"{LABELS}{path.name}", OTHER_TYPE, path, pack)
