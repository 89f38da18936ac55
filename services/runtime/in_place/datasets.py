"""Datasets in place: a single ZIP or tar, read in place.

**Conventions.** As recordings in place (`services/runtime/in_place/places.py`). A child reads a file of a folder
itself, and an object by ranges that its parent fetches (`services/runtime/in_place/served_ranges.py`).
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from services.runtime.in_place.folders import file_in_folder, placed_file
from services.runtime.in_place.places import checked_after, is_by_ranges, refuse_other, refuse_words
from services.runtime.in_place.served_ranges import PipedRanges, served_ranges
from services.runtime.in_place.settings import InPlaceSettings
from stone.errors import Refused
from stone_recordings.sync.stored_recording import RecordingPlace

ZIP, TAR = ".zip", ".tar"
DatasetArchivePath = Path | PipedRanges


def requested_dataset(settings: InPlaceSettings, place: RecordingPlace) -> RecordingPlace:
    """Return the place, checked by its text. Raises `unknown_root`, `bad_place`, `no_archive`, `not_by_ranges`."""
    refuse_words(settings, place, "a dataset such as released/STONE.zip")
    if not place.path.endswith((ZIP, TAR)):
        raise Refused(
            "no_archive",
            f"{place.name[:200]!r} is neither a {ZIP} nor a {TAR}, and folders cannot be imported in place; put it "
            "into a tar, or upload it with `stone dataset import FOLDER`",
        )
    if is_by_ranges(settings, place) and not place.path.endswith(ZIP):
        raise Refused(
            "not_by_ranges",
            f"{place.name[:200]!r} is in a bucket, from which only a {ZIP} can be read; mount the bucket below a "
            "folder that is a root, or upload the dataset",
        )
    return place


def found_dataset(settings: InPlaceSettings, place: RecordingPlace) -> RecordingPlace:
    """Return the place with the current state of its file.

    Raises `recording_vanished`, `root_unavailable`, `unknown_root`, `store_unavailable`.
    """
    if is_by_ranges(settings, place):
        from services.runtime.in_place.bucket import PlacedObject  # importing boto3 takes most of a second

        return replace(place, files=(PlacedObject(settings, place).file(),))
    return replace(place, files=(placed_file(file_in_folder(settings, place), place.name),))


def refuse_changed_dataset(settings: InPlaceSettings, place: RecordingPlace) -> None:
    """Raise `recording_changed_in_place` if the file differs from the note, and as `found_dataset`."""
    refuse_other(place, found_dataset(settings, place))


@contextmanager
def opened_dataset(
    settings: InPlaceSettings, place: RecordingPlace, folder: Path, fetched: Callable[[int], None]
) -> Iterator[DatasetArchivePath]:
    """Yield the archive for a child that may write to the folder; `fetched` gets the number of bytes read.

    Raises `recording_changed_in_place` if the file differs from the note, before the block or after it.
    """
    refuse_changed_dataset(settings, place)
    with checked_after(lambda: refuse_changed_dataset(settings, place)):
        if not is_by_ranges(settings, place):
            yield file_in_folder(settings, place)
            return
        from services.runtime.in_place.bucket import PlacedObject

        source = PlacedObject(settings, place)
        with served_ranges(source.read_at, place, folder) as ranges:
            yield ranges
        fetched(source.read_bytes)
