"""Errors of starting and activating re-scores, and of dismissing alarms."""

from typing import ClassVar

from stone.errors import StoneError


class TruthNotReadyError(StoneError):
    """The ground truth has not been made yet."""

    code: ClassVar[str] = "truth_not_ready"

    def __init__(self, number: int) -> None:
        super().__init__(f"ground truth {number} is not ready; wait for its job, or make another where that has failed")


class ForeignTruthError(StoneError):
    """The ground truth is that of another phase."""

    code: ClassVar[str] = "foreign_truth"

    def __init__(self, truth_id: str) -> None:
        super().__init__(f"this phase has no ground truth {truth_id[:80]!r}; is it that of another phase?")


class AlreadyActiveError(StoneError):
    """The board shows this evaluation version now."""

    code: ClassVar[str] = "already_active"

    def __init__(self, number: int, metric: str) -> None:
        super().__init__(
            f"the board shows ground truth {number} by {metric!r} now, so there is nothing to re-score; name another"
            " ground truth, another metric, or both"
        )


class RescoreStateError(StoneError):
    """The re-score is over."""

    code: ClassVar[str] = "wrong_state"

    def __init__(self, rescore_id: str, state: str, act: str) -> None:
        super().__init__(f"re-score {rescore_id} was {state} and cannot be {act}; start another one")


class RescoreIncompleteError(StoneError):
    """Entries would vanish from the board, since they have no score by the new evaluation version yet."""

    code: ClassVar[str] = "rescore_incomplete"

    def __init__(self, missing: int) -> None:
        self.missing = missing
        super().__init__(
            f"{missing} entries have no score by the new evaluation version yet; wait for its run, or start the"
            " re-score again where that has ended, which scores only what is missing"
            " (hide an entry that cannot be scored)"
        )


class BoardMovedError(StoneError):
    """Another evaluation version was activated since the board was read."""

    code: ClassVar[str] = "board_moved"

    def __init__(self, expected: str | None, found: str | None) -> None:
        super().__init__(f"the board is at activation {found}, not at {expected}; review the difference again")


class AlarmMissingError(StoneError):
    """There is no such alarm."""

    code: ClassVar[str] = "alarm_missing"

    def __init__(self, alarm_id: str) -> None:
        super().__init__(f"there is no alarm {alarm_id[:80]!r}")


class AlarmDismissedError(StoneError):
    """The alarm was already dismissed."""

    code: ClassVar[str] = "wrong_state"

    def __init__(self, alarm_id: str) -> None:
        super().__init__(f"alarm {alarm_id} was already dismissed; the reason is in the audit log")
