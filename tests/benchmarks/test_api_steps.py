"""Samples of the stack belong to the step of a request that they are in."""

import sys
from types import FrameType
from typing import Any

import pytest

from api.deps import identify
from benchmarks.api_steps.steps import NAMES, REST, StepSamples, step_of


def test_a_stack_without_known_frames_is_the_rest() -> None:
    assert step_of(sys._getframe()) == REST


def test_what_authentication_calls_is_authentication() -> None:
    seen: list[str] = []

    class Told:
        """Looked at from within `identify`."""

        @property
        def state(self) -> Any:
            seen.append(step_of(sys._getframe()))
            raise LookupError

    with pytest.raises(LookupError):
        identify(Told())  # type: ignore[arg-type]
    assert seen == ["authentication"]


def test_shares_of_a_kind_add_up_to_one() -> None:
    samples = StepSamples()
    with samples.taken():
        samples.kind = "busy"
        frame: FrameType | None = sys._getframe()
        while sum(counts.total() for counts in samples.counts.values()) < 3:
            step_of(frame)
    shares = samples.shares("busy")
    assert set(shares) == set(NAMES)
    assert abs(sum(shares.values()) - 1.0) < 1e-9
