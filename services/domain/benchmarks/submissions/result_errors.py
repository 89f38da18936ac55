"""Errors of reading results: not scored, withheld, not comparable, frames or predictions that are not shown."""

from stone.errors import StoneError

UNTIL = {
    "open": "only its team and administrators may see it",
    "running": "while the phase is running, only totals rounded to 4 digits are shown, even to the team itself",
    "ended": "only administrators may see it, since other phases may hide the same labels",
}


class NotScoredError(StoneError):
    """The submission has no score to show."""

    code = "not_scored"

    def __init__(self, submission_id: str, state: str) -> None:
        super().__init__(
            f"submission {submission_id} is {state} and has no score by the active evaluation version, so it has no "
            "results"
        )


class ScoreMissingError(StoneError):
    """Score not found, or no access."""

    code = "score_missing"

    def __init__(self, submission_id: str) -> None:
        super().__init__(
            f"submission {submission_id} has no such score that you may see; 'scores' in its results lists the "
            "available scores"
        )
