"""Why a delivery did not get through."""

from stone.errors import StoneError


class NotTakenError(StoneError):
    """The receiver did not take it, this time; `is_final`: nor will it later."""

    code = "not_taken"

    def __init__(self, why: str, is_final: bool = False, is_gone: bool = False) -> None:
        self.is_final, self.is_gone = is_final, is_gone
        super().__init__(why[:300])


class DeliveryFailedError(StoneError):
    """A delivery was given up: the dead letter of the job dashboard."""

    code = "delivery_failed"

    def __init__(self, channel: str, tries: int, answer: str) -> None:
        super().__init__(
            f"the {channel} did not accept it in {tries} attempts; the last: {answer}; retry the job to try again"
        )


class UnknownDeliveryError(StoneError):
    """The delivery of a job is not there any more."""

    code = "unknown_delivery"

    def __init__(self, delivery_id: str) -> None:
        super().__init__(f"delivery {delivery_id[:40]} no longer exists: it expired, or its user was removed")
