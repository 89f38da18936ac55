"""Errors of uploads."""

from stone.errors import StoneError


class BadMetadataError(StoneError):
    """Something said about the file cannot be meant."""

    code = "bad_upload_metadata"

    def __init__(self, name: str, value: str, expected: str) -> None:
        super().__init__(f"{name} is {value[:80]!r}; expected {expected}")


class UploadTooLargeError(StoneError):
    """The file is larger than this platform takes."""

    code = "upload_too_large"

    def __init__(self, length_bytes: int, limit_bytes: int) -> None:
        super().__init__(f"the file has {length_bytes} bytes, at most {limit_bytes} are taken; split it")


class TooManyUploadsError(StoneError):
    """The owner has too many unfinished or unused uploads."""

    code = "too_many_uploads"

    def __init__(self, limit: int) -> None:
        super().__init__(
            f"{limit} uploads of yours are unfinished or not used yet, and no more may be; does a client begin anew "
            "instead of resuming? use or delete some of them (GET /api/v1/uploads) or wait until they expire"
        )


class TooManyUploadsOfDraftError(StoneError):
    """The draft of a submission has more unfinished or unused uploads than it needs."""

    code = "too_many_uploads_of_draft"

    def __init__(self, draft_id: str, limit: int) -> None:
        super().__init__(
            f"{limit} uploads for the draft {draft_id[:64]!r} are unfinished or not used yet, and no more may be: "
            "it needs one; resume that one, or delete those that were given up"
        )


class UploadMissingError(StoneError):
    """There is no such upload, or it is somebody else's."""

    code = "upload_missing"

    def __init__(self, upload_id: str) -> None:
        super().__init__(f"there is no upload {upload_id[:64]!r} of yours")


class UploadTargetMissingError(StoneError):
    """What the upload is meant for does not exist, or is somebody else's."""

    code = "upload_target_missing"

    def __init__(self, purpose: str, target_id: str) -> None:
        super().__init__(f"there is no target {target_id[:64]!r} of yours for a {purpose}; create it first")


class UndeclaredUploadError(StoneError):
    """The file is not the one that the draft of the submission announces."""

    code = "not_as_announced"

    def __init__(self, field: str, given: object, announced: object) -> None:
        super().__init__(
            f"{field} is {str(given)[:80]!r}, the draft announces {str(announced)!r}; "
            "was the zip written again meanwhile? then make a new draft"
        )


class UploadGoneError(StoneError):
    """The upload ended without a file: expired, terminated or failed."""

    code = "upload_gone"

    def __init__(self, upload_id: str, state: str, detail: str) -> None:
        why = f" ({detail})" if detail else ""
        super().__init__(f"upload {upload_id} is {state}{why}; create a new one")


class UploadStateError(StoneError):
    """The upload is not in a state in which this can be done."""

    code = "wrong_upload_state"

    def __init__(self, upload_id: str, state: str, act: str, allowed: str) -> None:
        super().__init__(f"upload {upload_id} is {state} and cannot be {act}; only {allowed} uploads can")


class UploadPurposeError(StoneError):
    """The upload was declared to be something else."""

    code = "wrong_upload_purpose"

    def __init__(self, upload_id: str, declared: str, wanted: str) -> None:
        super().__init__(f"upload {upload_id} was declared to be a {declared}, not a {wanted}")


class UploadLockedError(StoneError):
    """Another request is writing to this upload."""

    code = "upload_locked"

    def __init__(self, upload_id: str) -> None:
        super().__init__(
            f"another request is writing to upload {upload_id}; wait for it, or until its client is missed"
        )


class OffsetMismatchError(StoneError):
    """The client would continue where the file does not end. `offset_bytes` is where it does."""

    code = "offset_mismatch"

    def __init__(self, given_bytes: int, offset_bytes: int) -> None:
        self.offset_bytes = offset_bytes
        super().__init__(f"{offset_bytes} bytes are here, not {given_bytes}; resume from byte {offset_bytes}")


class OverLengthError(StoneError):
    """More bytes came than were declared; those of this request were cut off again."""

    code = "over_length"

    def __init__(self, reached_bytes: int, length_bytes: int) -> None:
        super().__init__(
            f"the upload was declared with {length_bytes} bytes and this would make at least {reached_bytes}"
        )


class TooManyUploadPartsError(StoneError):
    """The upload came in so many small requests that it is not to be kept in as many objects."""

    code = "too_many_slabs"

    def __init__(self, upload_id: str, limit: int) -> None:
        super().__init__(
            f"upload {upload_id} is kept in {limit} objects, more are not made of one file; "
            "create a new one and send it in larger pieces, of some MiB each"
        )


class ChecksumMismatchError(StoneError):
    """The bytes of this request are not those that were sent; they were cut off again."""

    code = "checksum_mismatch"

    def __init__(self, first_byte: int, end_byte: int, algorithm: str) -> None:
        super().__init__(f"the {algorithm} of bytes {first_byte}-{end_byte} differs; they were discarded, resend them")


class FileMismatchError(StoneError):
    """The whole file is not the declared one; it was removed."""

    code = "sha256_mismatch"

    def __init__(self, upload_id: str, found: str, declared: str) -> None:
        super().__init__(
            f"upload {upload_id} has sha256 {found}, declared was {declared}; "
            "the file was removed, upload it again (did it change on your disk meanwhile?)"
        )


class DiskFullError(StoneError):
    """The disk is full; what was written before is kept."""

    code = "disk_full"

    def __init__(self, offset_bytes: int) -> None:
        super().__init__(f"the disk is full; {offset_bytes} bytes of this upload are kept, resume once space is freed")
