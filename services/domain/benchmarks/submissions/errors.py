"""Errors of creating and changing submissions."""

from datetime import UTC, datetime

from services.domain.benchmarks.phases.phases import DAY_NS
from stone.errors import StoneError


class ExhaustedError(StoneError):
    """The quota is used up; `next_ns` is when the next submission is available, null for never."""

    code = "exhausted"

    def __init__(self, sentence: str, next_ns: int | None) -> None:
        self.next_ns = next_ns
        when = f"the next one is available at {_moment(next_ns)}" if next_ns else "an administrator may grant more"
        super().__init__(f"{sentence}; {when}")


class ScoringsExhaustedError(ExhaustedError):
    """The team has had as many submissions scored as the phase allows."""

    code = "scorings_exhausted"

    def __init__(self, taken: int, limit: int, window_ns: int | None, next_ns: int | None) -> None:
        within = f"within {window_ns / DAY_NS:g} days" if window_ns else "in this phase"
        super().__init__(f"{taken} of {limit} submissions {within} are used or in progress", next_ns)


class ValidationsExhaustedError(ExhaustedError):
    """The team has had as many files checked within a day as the phase allows."""

    code = "validations_exhausted"

    def __init__(self, limit: int, next_ns: int | None) -> None:
        super().__init__(
            f"all {limit} validation-only submissions of the day are used ('stone validate' checks a file locally)",
            next_ns,
        )


class PhaseClosedError(StoneError):
    """The phase takes no submissions now."""

    code = "phase_closed"

    def __init__(self, name: str, opens_ns: int | None, closes_ns: int | None, now_ns: int) -> None:
        if opens_ns is not None and now_ns < opens_ns:
            super().__init__(f"phase {name!r} opens at {_moment(opens_ns)}; it is {_moment(now_ns)} now")
        else:
            super().__init__(f"phase {name!r} closed at {_moment(closes_ns or now_ns)} and takes no submissions")


class SubmissionStateError(StoneError):
    """The submission is not in a state in which this can be done."""

    code = "wrong_state"

    def __init__(self, submission_id: str, state: str, act: str, allowed: str) -> None:
        super().__init__(f"submission {submission_id} is {state} and cannot be {act}; only {allowed} ones can")


class HashMismatchError(StoneError):
    """The uploaded file is not the one that was declared."""

    code = "hash_mismatch"

    def __init__(self, found: str, declared: str) -> None:
        super().__init__(
            f"the upload has sha256 {found or 'unknown'}, declared was {declared}; was the zip written again meanwhile?"
        )


class SubmissionTooLargeError(StoneError):
    """The file is larger than all frames of the phase could be."""

    code = "submission_too_large"

    def __init__(self, size_bytes: int, limit_bytes: int, frames: int) -> None:
        super().__init__(
            f"the zip has {size_bytes} bytes, but {frames} frames never need more than {limit_bytes}; "
            "does it hold anything beside one .npz a frame?"
        )


class TooManyOpenError(StoneError):
    """The team has too many submissions that are not settled."""

    code = "too_many_open"

    def __init__(self, limit: int) -> None:
        super().__init__(
            f"{limit} submissions of this team are open in this phase; finish or cancel some of them first"
        )


def _moment(moment_ns: int) -> str:
    return datetime.fromtimestamp(moment_ns // 10**9, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
