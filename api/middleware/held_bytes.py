"""A budget of the bytes of request bodies that this process holds, in total and per sender.

**Conventions.** Used by one event loop. A sender is a user, or the address of a request without a caller. Each sender
has `1/SHARES` of the budget, so no sender can use it up. `OVERHEAD_BYTES` is the size of a request without its body.
"""

from collections import Counter

from api.errors import ApiError

SHARES = 4
OVERHEAD_BYTES = 16 * 2**10


class BodyBudget:
    """The held bytes, by sender."""

    def __init__(self, most_bytes: int, largest_bytes: int) -> None:
        self._most_bytes = most_bytes
        self._share_bytes = max(most_bytes // SHARES, largest_bytes + OVERHEAD_BYTES)
        self._held_bytes = Counter[str]()
        self.held_bytes = 0

    def take(self, sender: str, size_bytes: int) -> None:
        """Hold `size_bytes` more for the sender. Raises `busy`."""
        of_sender = self._held_bytes[sender] + size_bytes
        if self.held_bytes + size_bytes > self._most_bytes or of_sender > self._share_bytes:
            self._forget(sender)
            raise bodies_held()
        self._held_bytes[sender] = of_sender
        self.held_bytes += size_bytes

    def give_back(self, sender: str, size_bytes: int) -> None:
        self._held_bytes[sender] -= size_bytes
        self.held_bytes -= size_bytes
        self._forget(sender)

    def _forget(self, sender: str) -> None:
        if not self._held_bytes[sender]:
            del self._held_bytes[sender]


def bodies_held() -> ApiError:
    return ApiError("busy", "request bodies, yours or all users', take too much memory; try again in a moment")
