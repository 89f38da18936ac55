"""Errors of reading results: not scored, withheld, not comparable, frames or predictions that are not shown."""

from services.domain.benchmarks.visibility import Secrecy
from stone.errors import StoneError

UNTIL = {
    "open": "only its team and administrators may see it",
    "running": "while the phase runs only totals rounded to 4 digits are shown, also to its own team",
    "ended": "only administrators may see it, since other phases may hide the same labels",
}


class NotScoredError(StoneError):
    """The submission has no score that could be shown."""

    code = "not_scored"

    def __init__(self, submission_id: str, state: str) -> None:
        super().__init__(
            f"submission {submission_id} is {state} and has no score by the evaluation version in force, so no results"
        )


class ScoreMissingError(StoneError):
    """Score not found, or no access."""

    code = "score_missing"

    def __init__(self, submission_id: str) -> None:
        super().__init__(
            f"submission {submission_id} has no such score that you may see; 'scores' of its results lists them"
        )


class WithheldError(StoneError):
    """This part of a result is not shown to the caller, or not yet."""

    code = "withheld"

    def __init__(self, what: str, secrecy: Secrecy) -> None:
        super().__init__(f"{what} of this submission cannot be shown: {UNTIL[secrecy]}")


class NotComparableError(StoneError):
    """Two submissions have no score by one ground truth and metric in this phase."""

    code = "not_comparable"

    def __init__(self, submission_id: str, phase: str) -> None:
        super().__init__(
            f"submission {submission_id} has no score by the evaluation version in force of phase {phase!r}; "
            "both must be scored entries of this phase"
        )


class FramesHiddenError(StoneError):
    """Pictures of frames are not shown where the ground truth is hidden."""

    code = "frames_hidden"

    def __init__(self, phase: str) -> None:
        super().__init__(
            "pictures of frames are shown where the ground truth is open; "
            f"that of phase {phase!r} is hidden and stays so"
        )


class PredictionsGoneError(StoneError):
    """The zip of this submission is not kept any more."""

    code = "predictions_gone"

    def __init__(self, submission_id: str) -> None:
        super().__init__(
            f"the zip of submission {submission_id} is not kept any more; its scores stay, its predictions are gone"
        )
