"""Errors of uploads."""

from stone.errors import Refused, StoneError


class BadMetadataError(StoneError):
    """Invalid upload metadata."""

    code = "bad_upload_metadata"

    def __init__(self, name: str, value: str, expected: str) -> None:
        super().__init__(f"upload metadata: {name} is {value[:80]!r}; expected {expected}")


def upload_too_large(length_bytes: int, limit_bytes: int) -> Refused:
    return Refused("upload_too_large", f"the file has {length_bytes} bytes, the limit is {limit_bytes}; split it")


def upload_gone(upload_id: str, state: str, detail: str) -> Refused:
    why = f" ({detail})" if detail else ""
    return Refused("upload_gone", f"upload {upload_id} is {state}{why}; create a new one")


def upload_state(upload_id: str, state: str, act: str, allowed: str) -> Refused:
    return Refused(
        "wrong_upload_state", f"upload {upload_id} is {state} and cannot be {act}; only {allowed} uploads can"
    )


class UploadLockedError(StoneError):
    """Another request is writing to this upload."""

    code = "upload_locked"

    def __init__(self, upload_id: str) -> None:
        super().__init__(
            f"another request is writing to upload {upload_id}; try again when it has ended or its client timed out"
        )


class FileMismatchError(StoneError):
    """The whole file is not the declared one; it was removed."""

    code = "sha256_mismatch"

    def __init__(self, upload_id: str, found: str, declared: str) -> None:
        super().__init__(
            f"upload {upload_id} has sha256 {found}, but {declared} was declared; the platform deleted the file: "
            "check that it has not changed on your disk, and upload it again"
        )


class DiskFullError(StoneError):
    """The disk is full, or full up to its reserve (`why`); written bytes are kept."""

    code = "disk_full"

    def __init__(self, offset_bytes: int, why: str = "the disk is full") -> None:
        super().__init__(f"{why}; {offset_bytes} bytes of this upload are kept: free space and resume")
        self.why = why
