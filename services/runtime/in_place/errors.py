"""Refusals of recordings and datasets in place."""

from stone.errors import Refused
from stone_recordings.sync.stored_recording import PlacedFile, RecordingPlace

ANEW = "remove the recording or import and add the file again (labels made from it stay)"


def changed_in_place(place: RecordingPlace, current: PlacedFile, known: PlacedFile | None) -> Refused:
    was = f"was registered with {known.size_bytes} bytes in version {known.version}" if known else "came since"
    return Refused(
        "recording_changed_in_place",
        f"{current.name} of {place} has {current.size_bytes} bytes in version {current.version}, and {was}; restore "
        f"the file, or {ANEW}",
    )


def content_changed(place: RecordingPlace) -> Refused:
    return Refused(
        "recording_changed_in_place",
        f"{place} has its registered sizes and versions, but contains other messages; {ANEW}",
    )


def vanished(place: RecordingPlace, name: str) -> Refused:
    return Refused(
        "recording_vanished",
        f"there is no readable {name} at {place}; restore it, mount the root on every worker, or {ANEW}",
    )
