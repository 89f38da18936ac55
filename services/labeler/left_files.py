"""Files that children left to be published, as the parent finds them: by names that objects can have, and no links."""

from dataclasses import dataclass
from pathlib import Path

from services.labeler.child_answers import PackAnswer
from services.labeler.label_rows import LABELS, MEDIA_TYPES, OTHER_TYPE
from services.runtime.sandbox import SandboxCrashedError
from services.runtime.store.keys import checked


@dataclass(frozen=True)
class LeftFile:
    """A file to publish; `name` is its artefact's. `pack` says of a pack where its frames lie."""

    name: str
    media_type: str
    path: Path
    pack: PackAnswer | None = None


def left_file(name: str, path: Path) -> LeftFile:
    return LeftFile(name, MEDIA_TYPES.get(path.suffix, OTHER_TYPE), path)


def files_left(folder: Path) -> list[LeftFile]:
    """Every file below the folder in the order of their names, but those that are still being written.

    Raises `bad_key` for a name that no object can have.
    """
    found = sorted(path for path in folder.rglob("[!.]*") if path.is_file() and not path.is_symlink())
    for path in found:
        checked(path.relative_to(folder.parent).as_posix())
    return [left_file(path.relative_to(folder).as_posix(), path) for path in found]


def pack_left(path: Path, pack: PackAnswer) -> LeftFile:
    """A pack of labels. Raises `SandboxCrashedError` where it is not as long as was said."""
    size_bytes = path.stat().st_size
    if size_bytes != pack.size_bytes:
        raise SandboxCrashedError(f"reported {pack.size_bytes} bytes of {pack.name}, which has {size_bytes}")
    return LeftFile(f"{LABELS}{path.name}", OTHER_TYPE, path, pack)
