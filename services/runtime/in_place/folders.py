"""Recordings in allowed folders: found, and linked under the names of their files.

**Conventions.** A path is relative to a root of the settings. It is resolved with all symbolic links. Paths outside the
root and missing files are refused with the same message, so that nothing is revealed about other files.
"""

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from services.runtime.in_place.errors import vanished
from services.runtime.in_place.settings import InPlaceSettings
from services.runtime.settings import Settings
from services.runtime.store.named_objects import NAMES_FOLDER, linked_bag
from stone.errors import PlatformFaultError, Refused
from stone_files.bag_fingerprint import MOST_FILES, bag_parts, check_bag_files, is_bag_part
from stone_recordings.sync.stored_recording import PlacedFile, RecordingPlace


def files_in_folder(settings: InPlaceSettings, place: RecordingPlace) -> tuple[PlacedFile, ...]:
    """Return the bag's files. Raises `recording_vanished`, `root_unavailable`, `bad_recording_files`."""
    return tuple(placed_file(path, path.name) for path in _files_of(settings, place))


def located_in_place(settings: Settings, place: RecordingPlace) -> Path:
    """Return the bag, as links with the names of its files. Raises as `files_in_folder`."""
    links = settings.root / NAMES_FOLDER
    files = {path.name: path.resolve() for path in _files_of(settings.in_place, place)}
    if _resolve(settings.in_place, place).is_dir():
        return linked_bag(links, str(place), files, place.name)
    return linked_bag(links, str(place), files) / place.name


def file_in_folder(settings: InPlaceSettings, place: RecordingPlace) -> Path:
    """Return the single file at the place, resolved.

    Raises `recording_vanished`, `root_unavailable`, `unknown_root`.
    """
    path = _resolve(settings, place)
    if not path.is_file() or not os.access(path, os.R_OK):
        raise vanished(place, place.name)
    return path


def _files_of(settings: InPlaceSettings, place: RecordingPlace) -> list[Path]:
    """Return the files of the bag; all are within the root."""
    root, parts = _root(settings, place), list[Path]()
    _resolve(settings, place)
    with suppress(PermissionError):
        parts = bag_parts(root / place.path)
    if not 1 <= len(parts) <= MOST_FILES or not is_bag_part(parts[0].name):
        raise vanished(place, place.name)
    if outside := next(_outside(root, parts), None):
        raise vanished(place, outside.name)
    if len(parts) > 1:
        check_bag_files([part.name for part in parts])
    return parts


def _outside(root: Path, parts: list[Path]) -> Iterator[Path]:
    return (part for part in parts if not part.resolve().is_relative_to(root) or not part.is_file())


def _resolve(settings: InPlaceSettings, place: RecordingPlace) -> Path:
    root = _root(settings, place)
    try:
        bag = (root / place.path).resolve(strict=True)
        if bag.is_relative_to(root) and (bag.is_file() or bag.is_dir()):
            return bag
    except (OSError, RuntimeError):  # missing, unreadable, or circular links
        pass
    raise vanished(place, place.name)


def _root(settings: InPlaceSettings, place: RecordingPlace) -> Path:
    """Return the root. Raises `root_unavailable` while it is not mounted, `unknown_root` if it is not configured."""
    if (folder := settings.folder_of.get(place.root)) is None:
        raise Refused(
            "unknown_root", f"root {place.root} for recordings in place is not configured any more; configure it again"
        )
    root = Path(folder)
    if not root.is_dir():
        raise PlatformFaultError("root_unavailable", f"the folder of root {place.root} is not on this worker; mount it")
    return root.resolve()


def placed_file(path: Path, name: str) -> PlacedFile:
    """Return the file with its current size and version."""
    status = path.stat()
    return PlacedFile(name, status.st_size, str(status.st_mtime_ns))
