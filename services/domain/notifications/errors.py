"""Errors of notification targets."""

from stone.errors import StoneError


class BadWebhookUrlError(StoneError):
    """The webhook URL is not allowed."""

    code = "bad_webhook_url"

    def __init__(self, why: str) -> None:
        super().__init__(f"this webhook cannot be used: {why}")
