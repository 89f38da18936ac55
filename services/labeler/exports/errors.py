"""Why labels cannot be exported."""

from collections.abc import Iterable
from pathlib import Path

from stone.errors import StoneError


class NotLabelsError(StoneError):
    """The folder is not what `stone label` leaves."""

    code = "not_labels"

    def __init__(self, directory: Path, missing: str) -> None:
        super().__init__(
            f"{directory} has no {missing}, so it is not a folder that `stone label` of this version wrote; "
            "give the folder that was named with --output, or label the recording again"
        )


class DamagedLabelsError(StoneError):
    """A file of the label set cannot be read."""

    code = "damaged_labels"

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"{path} cannot be read: {reason[:200]}; was it changed by hand? Label the recording again")


class RecordingGoneError(StoneError):
    """The recording is no longer where it was labelled."""

    code = "recording_gone"

    def __init__(self, path: Path | None) -> None:
        where = f"the recording {path} is gone" if path else "nothing says where the recording of these labels is"
        super().__init__(f"{where}; say with --bag where it is now")


class UnknownFormatError(StoneError):
    """There is no export of this name."""

    code = "unknown_format"

    def __init__(self, name: str, known: Iterable[str]) -> None:
        super().__init__(f"{name[:80]!r} is no format of an export; known are {', '.join(known)}")


class MapTooLargeError(StoneError):
    """The map of a sequence is larger than any robot drives in one run."""

    code = "map_too_large"

    def __init__(self, width_m: float, height_m: float, limit_m: float) -> None:
        super().__init__(
            f"the map spans {width_m:.0f} × {height_m:.0f} m, the limit is {limit_m:.0f} m a side; "
            "did a pose of the recording jump?"
        )


class NotAnExportError(StoneError):
    """The folder that is to take a sequence in is not an export it can join."""

    code = "not_an_export"

    def __init__(self, out: Path, reason: str) -> None:
        super().__init__(f"{out} cannot take this export in: {reason}; choose another --output, or remove the folder")


class ExportClashError(StoneError):
    """Two sequences of one export would have the same file."""

    code = "export_clash"

    def __init__(self, path: str, sequence: str) -> None:
        super().__init__(
            f"{path[:200]} of sequence {sequence} is another sequence's file in this export already; "
            "was one recording labelled under two names?"
        )


class MeshTooLargeError(StoneError):
    """A binary glTF says its length in 32 bits."""

    code = "mesh_too_large"

    def __init__(self, size_bytes: int, limit_bytes: int) -> None:
        super().__init__(
            f"the mesh takes {size_bytes} bytes as binary glTF, the format ends at {limit_bytes}; use the PLY"
        )
