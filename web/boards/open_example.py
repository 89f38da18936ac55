"""Frames of an open phase on pages: an example of labels, and a frame of a method.

**Conventions.** `services/domain/benchmarks/phases/open_frames.py` decides which frames may be shown, as for the
pictures' routes. Without such a frame, a page has no picture.
"""

from dataclasses import dataclass

from services.domain.benchmarks.phases.open_frames import OpenTruth, open_frames
from services.runtime.platform import Platform

STOPS = 24


@dataclass(frozen=True)
class ChosenFrame:
    """A frame among those of its phase: `number` counts from 1 of `total`; neighbours are empty at either end."""

    token: str
    sequence: str
    number: int
    total: int
    before: str
    after: str


def chosen_frame(platform: Platform, located: OpenTruth | None, token: str | None = None) -> ChosenFrame | None:
    """Return the frame of this token, else the one in the middle; None if no frame may be shown.

    Reads the store, so it must not run within a transaction. The neighbours are chosen so that `STOPS` of them span all
    frames.
    """
    shown = open_frames(platform.store, located).sequences if located else {}
    if not shown:
        return None
    tokens = tuple(shown)
    at = tokens.index(token) if token in shown else len(tokens) // 2
    step = max(1, len(tokens) // STOPS)
    before = tokens[max(at - step, 0)] if at > 0 else ""
    after = tokens[min(at + step, len(tokens) - 1)] if at < len(tokens) - 1 else ""
    return ChosenFrame(tokens[at], shown[tokens[at]], at + 1, len(tokens), before, after)
