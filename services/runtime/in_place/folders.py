"""Recordings in allowed folders: found, held against what was registered, and linked by the names of their files.

**Conventions.** A path is given relative to a root of the settings. It is resolved with all symbolic links, and what
lies outside of the root is refused in the same words as what is not there, so nothing can be learnt of other files.
A file is known by its size and the time of its last change; what was read of it has a hash besides
(`stone_recordings/bags/content_hash.py`).
"""

from collections.abc import Iterator
from contextlib import suppress
from hashlib import sha256
from pathlib import Path

from services.runtime.in_place.settings import InPlaceSettings
from services.runtime.settings import Settings
from services.runtime.store.named_objects import NAMES_FOLDER, linked_bag
from stone.errors import PlatformFaultError, Refused
from stone_files.bag_fingerprint import MOST_FILES, bag_parts, check_bag_files, is_bag_part
from stone_recordings.sync.stored_recording import PlacedFile, RecordingPlace

LONGEST_PATH = 1024
KEPT = "labels that were made of it stay"


def requested_place(settings: InPlaceSettings, root: str, path: str) -> RecordingPlace:
    """The place, checked as far as words go: nobody looks whether it is there.

    Raises `unknown_root`, `bad_place`.
    """
    if root not in settings.roots:
        known = ", ".join(settings.roots) or "none: an administrator sets STONE_IN_PLACE__FOLDERS"
        raise Refused("unknown_root", f"there is no root {root[:80]!r} for recordings in place; there is {known}")
    parts = path.split("/")
    is_plain = len(path) <= LONGEST_PATH and path.isprintable() and not {"", ".", ".."} & set(parts)
    if not is_plain:
        raise Refused(
            "bad_place",
            f"{path[:200]!r} is no path below a root; name a bag as 2026/run.mcap, without a leading slash and .., "
            f"in at most {LONGEST_PATH} characters",
        )
    return RecordingPlace(root, path)


def found_place(settings: InPlaceSettings, place: RecordingPlace) -> RecordingPlace:
    """The place with its files as they are. Raises `recording_vanished`, `root_away`, `bad_recording_files`."""
    files = tuple(_placed_file(path) for path in _files_of(settings, place))
    return RecordingPlace(place.root, place.path, files)


def sha256_in_place(place: RecordingPlace, content_sha256: str) -> str:
    """The hash that stands for the recording: of its files as they are listed, and of what was read of them."""
    lines = (f"{file.version} {file.size_bytes} {file.name}\n" for file in place.files)
    return sha256("".join((*lines, content_sha256)).encode()).hexdigest()


def refuse_changed(settings: InPlaceSettings, place: RecordingPlace) -> None:
    """Raises `recording_changed_in_place` for the first file that is not as registered, `recording_vanished`,
    `root_away`."""
    now = {file.name: file for file in found_place(settings, place).files}
    for file in place.files:
        if (found := now.pop(file.name, None)) is None:
            raise _vanished(place, file.name)
        if found != file:
            raise changed_in_place(place, found, file)
    for file in now.values():
        raise changed_in_place(place, file, None)


def located_in_place(settings: Settings, place: RecordingPlace) -> Path:
    """The bag, by links that are called as its files are. Raises as `refuse_changed`."""
    refuse_changed(settings.in_place, place)
    links = settings.root / NAMES_FOLDER
    files = {path.name: path.resolve() for path in _files_of(settings.in_place, place)}
    if _resolved(settings.in_place, place).is_dir():
        return linked_bag(links, str(place), files, place.name)
    return linked_bag(links, str(place), files) / place.name


def changed_in_place(place: RecordingPlace, found: PlacedFile, known: PlacedFile | None) -> Refused:
    was = f"was registered with {known.size_bytes} bytes, changed at {known.version}" if known else "came since"
    return Refused(
        "recording_changed_in_place",
        f"{found.name} of {place} has {found.size_bytes} bytes, changed at {found.version}, and {was}; "
        f"put the file back, or remove the recording and add it anew: {KEPT}",
    )


def content_changed(place: RecordingPlace) -> Refused:
    return Refused(
        "recording_changed_in_place",
        f"{place} has the sizes and times of change that it was registered with, and holds other messages; "
        f"remove the recording and add it anew: {KEPT}",
    )


def _vanished(place: RecordingPlace, name: str) -> Refused:
    return Refused(
        "recording_vanished",
        f"there is no bag {name} at {place} that may be read; put it back, mount the root on every worker, or remove "
        f"the recording: {KEPT}",
    )


def _files_of(settings: InPlaceSettings, place: RecordingPlace) -> list[Path]:
    """The files of the bag, none of which lies outside of the root."""
    root, parts = _root(settings, place), list[Path]()
    _resolved(settings, place)
    with suppress(PermissionError):
        parts = bag_parts(root / place.path)
    if not 1 <= len(parts) <= MOST_FILES or not is_bag_part(parts[0].name):
        raise _vanished(place, place.name)
    if outside := next(_outside(root, parts), None):
        raise _vanished(place, outside.name)
    if len(parts) > 1:
        check_bag_files([part.name for part in parts])
    return parts


def _outside(root: Path, parts: list[Path]) -> Iterator[Path]:
    return (part for part in parts if not part.resolve().is_relative_to(root) or not part.is_file())


def _resolved(settings: InPlaceSettings, place: RecordingPlace) -> Path:
    root = _root(settings, place)
    try:
        bag = (root / place.path).resolve(strict=True)
        if bag.is_relative_to(root) and (bag.is_file() or bag.is_dir()):
            return bag
    except (OSError, RuntimeError):  # not there, not ours to read, or links in a circle
        pass
    raise _vanished(place, place.name)


def _root(settings: InPlaceSettings, place: RecordingPlace) -> Path:
    """Raises `root_away` while it is not mounted, `unknown_root` once it is no root any more."""
    if (folder := settings.folder_of.get(place.root)) is None:
        raise Refused("unknown_root", f"{place.root} is no root for recordings in place any more; set it again")
    root = Path(folder)
    if not root.is_dir():
        raise PlatformFaultError("root_away", f"the folder of root {place.root} is not on this worker; mount it")
    return root.resolve()


def _placed_file(path: Path) -> PlacedFile:
    status = path.stat()
    return PlacedFile(path.name, status.st_size, str(status.st_mtime_ns))
