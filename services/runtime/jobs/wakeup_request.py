"""How a worker reads a wake-up: the time limit is the application's, whatever the message says.

**Conventions.** A header `timelimit` is anybody's who can write to the broker; with it each wake-up would kill the
process that works for it, and with three of them the job.
"""

from typing import Any

from celery.worker.request import Request


class WakeUpRequest(Request):  # type: ignore[misc]
    """A message as a worker holds it, without limits of its own."""

    @property
    def time_limits(self) -> tuple[None, None]:
        return None, None

    @time_limits.setter
    def time_limits(self, _said: Any) -> None:
        """Celery sets what the message says; it is not kept."""
