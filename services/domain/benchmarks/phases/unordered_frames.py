"""Unordered frames: one frame in n of each sequence, under tokens of the phase, in an order independent of time.

**Conventions.** Labels follow from sweeps, poses and their order, so a hidden phase may withhold poses, stamps and
order (`Phase.every_nth`). A frame's own token is a hash of its stamp, so a search can recover the stamp. Its phase
token is an HMAC under the phase's secret `token_key`. The frames of a sequence are sorted by phase token.
"""

import hmac
from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256

TOKEN_DIGITS = 32


@dataclass(frozen=True)
class UnorderedFrames:
    """The frames that a phase selects; a plain value, for sandboxed children."""

    every_nth: int
    token_key: str

    def of(self, tokens: Sequence[str]) -> tuple[tuple[str, int], ...]:
        """Return phase token and place in time of each selected frame; `tokens` are the sequence's, in time order."""
        return tuple(sorted((self._phase_token(tokens[at]), at) for at in range(0, len(tokens), self.every_nth)))

    def _phase_token(self, own: str) -> str:
        return hmac.new(bytes.fromhex(self.token_key), own.encode(), sha256).hexdigest()[:TOKEN_DIGITS]


def unordered_frames(every_nth: int | None, token_key: str | None) -> UnorderedFrames | None:
    """Return the selection of a phase with these columns, or None if it has all frames in order, with their poses."""
    return None if every_nth is None or token_key is None else UnorderedFrames(every_nth, token_key)
