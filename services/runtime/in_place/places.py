"""Recordings in place, for every kind of root: named, found, and compared with their registration.

**Conventions.** A file is identified by its size and version: the time of its last change, or an object's ETag. Its
read content also has a hash (`stone_recordings/bags/content_hash.py`).
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from hashlib import sha256

from services.runtime.in_place.errors import changed_in_place, vanished
from services.runtime.in_place.folders import files_in_folder
from services.runtime.in_place.settings import InPlaceSettings
from stone.errors import Refused, StoneError
from stone_recordings.sync.stored_recording import PlacedFile, RecordingPlace

LONGEST_PATH = 1024
BY_RANGES = ".mcap"


def requested_place(settings: InPlaceSettings, place: RecordingPlace) -> RecordingPlace:
    """Return the place, checked by its text only; its existence is not checked.

    Raises `unknown_root`, `bad_place`, `not_by_ranges`.
    """
    refuse_words(settings, place, "a bag such as 2026/run.mcap")
    if is_by_ranges(settings, place) and not place.path.endswith(BY_RANGES):
        raise Refused(
            "not_by_ranges",
            f"{place.name[:200]!r} is in a bucket, from which only an {BY_RANGES} can be read. Mount the bucket below "
            "a folder that is a root, convert the bag to MCAP, or upload it",
        )
    return place


def refuse_words(settings: InPlaceSettings, place: RecordingPlace, written: str) -> None:
    """Refuse an invalid place; `written` is a valid example. Raises `unknown_root`, `bad_place`."""
    if place.root not in settings.roots:
        known = ", ".join(settings.roots) or "none (an administrator sets STONE_IN_PLACE__FOLDERS)"
        raise Refused("unknown_root", f"there is no root {place.root[:80]!r} for files in place; the roots are {known}")
    is_plain = len(place.path) <= LONGEST_PATH and place.path.isprintable()
    if not is_plain or {"", ".", ".."} & set(place.path.split("/")):
        raise Refused(
            "bad_place",
            f"{place.path[:200]!r} is not a path within a root; give {written}, without a leading slash and .., with "
            f"at most {LONGEST_PATH} characters",
        )


def is_by_ranges(settings: InPlaceSettings, place: RecordingPlace) -> bool:
    """Return whether the place is an object of a bucket."""
    return place.root in settings.bucket_of


def found_place(settings: InPlaceSettings, place: RecordingPlace) -> RecordingPlace:
    """Return the place with the current state of its files.

    Raises `recording_vanished`, `root_unavailable`, `bad_recording_files`, `unknown_root`, `store_unavailable`.
    """
    if is_by_ranges(settings, place):
        from services.runtime.in_place.bucket import PlacedObject  # importing boto3 takes most of a second

        return replace(place, files=(PlacedObject(settings, place).file(),))
    return replace(place, files=files_in_folder(settings, place))


def refuse_changed(settings: InPlaceSettings, place: RecordingPlace) -> None:
    """Raise `recording_changed_in_place` for the first unregistered change, and as `found_place`."""
    refuse_other(place, found_place(settings, place))


def refuse_other(place: RecordingPlace, current: RecordingPlace) -> None:
    """Do as `refuse_changed`, for files that were found."""
    now: Mapping[str, PlacedFile] = {file.name: file for file in current.files}
    known = {file.name: file for file in place.files}
    for name in (*known, *(name for name in now if name not in known)):
        if name not in now:
            raise vanished(place, name)
        if now[name] != known.get(name):
            raise changed_in_place(place, now[name], known.get(name))


@contextmanager
def checked_after(check: Callable[[], None]) -> Iterator[None]:
    """Run a block that reads files in place, then `check`, whose error replaces the block's.

    Data of a file that differs from its registration must not be used.
    """
    try:
        yield
    except (StoneError, OSError):
        check()
        raise
    check()


def sha256_in_place(place: RecordingPlace, content_sha256: str) -> str:
    """Return the common hash of the file list and of the content that was read."""
    lines = (f"{file.version} {file.size_bytes} {file.name}\n" for file in place.files)
    return sha256("".join((*lines, content_sha256)).encode()).hexdigest()
