"""Errors of recordings that cannot be stored."""

from stone.errors import Refused, StoneError


class RecordingChangedError(StoneError):
    """The bytes differ from the uploaded bytes."""

    code = "recording_changed"

    def __init__(self, filename: str, actual: str, expected: str) -> None:
        super().__init__(
            f"{filename} has sha256 {actual}, but was received with {expected}; upload it again (is the disk failing?)"
        )


def recording_file_missing(filename: str, upload_id: str) -> Refused:
    return Refused(
        "recording_file_missing",
        f"the file of {filename} (upload {upload_id}) is not on this machine; "
        "do API and ingest workers share the uploads folder?",
    )
