"""Errors of creating and changing submissions."""

from datetime import UTC, datetime

from services.domain.benchmarks.phases.phases import DAY_NS
from stone.errors import Refused, StoneError


class ExhaustedError(Refused):
    """The quota is used up; `next_ns` is when the next submission is available, null for never."""

    def __init__(self, code: str, sentence: str, next_ns: int | None) -> None:
        self.next_ns = next_ns
        when = f"the next one is available at {_moment(next_ns)}" if next_ns else "an administrator may grant more"
        super().__init__(code, f"{sentence}; {when}")


def scorings_exhausted(taken: int, limit: int, window_ns: int | None, next_ns: int | None) -> ExhaustedError:
    within = f"within {window_ns / DAY_NS:g} days" if window_ns else "in this phase"
    sentence = f"{taken} of {limit} submissions {within} are used or in progress"
    return ExhaustedError("scorings_exhausted", sentence, next_ns)


def phase_closed(name: str, opens_ns: int | None, closes_ns: int | None, now_ns: int) -> Refused:
    if opens_ns is not None and now_ns < opens_ns:
        return Refused(
            "phase_closed", f"phase {name!r} opens at {_moment(opens_ns)}; the current time is {_moment(now_ns)}"
        )
    closed = f"phase {name!r} closed at {_moment(closes_ns or now_ns)} and accepts no submissions"
    return Refused("phase_closed", closed)


class SubmissionStateError(StoneError):
    """The submission's state does not allow the action."""

    code = "wrong_state"

    def __init__(self, submission_id: str, state: str, act: str, allowed: str) -> None:
        super().__init__(f"submission {submission_id} is {state} and cannot be {act}; only {allowed} submissions can")


def _moment(moment_ns: int) -> str:
    return datetime.fromtimestamp(moment_ns // 10**9, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
