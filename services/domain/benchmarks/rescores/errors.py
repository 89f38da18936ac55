"""Errors of starting and activating re-scores, and of dismissing alarms."""

from stone.errors import StoneError


class RescoreStateError(StoneError):
    """The re-score is over."""

    code = "wrong_state"

    def __init__(self, rescore_id: str, state: str, act: str) -> None:
        super().__init__(f"re-score {rescore_id} was {state} and cannot be {act}; start another re-score")


class AlarmDismissedError(StoneError):
    """The alarm was already dismissed."""

    code = "wrong_state"

    def __init__(self, alarm_id: str) -> None:
        super().__init__(f"alarm {alarm_id} was already dismissed; the reason is in the audit log")
