"""Why a received recording cannot be kept."""

from stone.errors import StoneError


class RecordingChangedError(StoneError):
    """The bytes are not those that were uploaded."""

    code = "recording_changed"

    def __init__(self, filename: str, found: str, expected: str) -> None:
        super().__init__(
            f"{filename} has sha256 {found} and was received with {expected}; upload it again (is the disk failing?)"
        )


class RecordingFileMissingError(StoneError):
    """The uploaded file is not where the workers look for it."""

    code = "recording_file_missing"

    def __init__(self, filename: str, upload_id: str) -> None:
        super().__init__(
            f"the file of {filename} (upload {upload_id}) is not on this machine; "
            "do API and ingest workers share the uploads folder?"
        )


class RecordingRefusedError(StoneError):
    """The recording was refused before, for the reason given."""

    code = "recording_refused"

    def __init__(self, filename: str, reason: str) -> None:
        super().__init__(f"{filename} was refused: {reason}")
