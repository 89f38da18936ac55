"""What `benchmarks.load` tells by quarter of its time."""

from types import SimpleNamespace
from typing import Any

import pytest

from benchmarks.load.quarters import UNTIL_SCORED, quarters


def watched(looked_s: list[float], **used_s: list[float]) -> Any:
    return SimpleNamespace(looked_s=looked_s, used_s=used_s)


def test_what_grows_is_seen() -> None:
    """Ten requests a second for 8 s, of which each costs more than the one before."""
    begun = [at / 10 for at in range(80)]
    waited = [0.01 * (1 + at // 20) for at in range(80)]
    watch = watched([0.0, 2.0, 4.0, 6.0, 8.2], api=[5.0, 5.1, 5.3, 5.6, 6.0])
    found = quarters({"list": begun, UNTIL_SCORED: [0.0]}, {"list": waited, UNTIL_SCORED: [7.0]}, watch)
    assert [one.p50_ms for one in found] == pytest.approx([10.0, 20.0, 30.0, 40.0])
    assert [one.requests_per_s for one in found] == pytest.approx([10.0] * 4, rel=0.06)
    costs = [one.cpu_ms["api"] for one in found]
    assert costs == pytest.approx([5.0, 10.0, 15.0, 20.0], rel=0.15)


def test_before_anything_was_answered_there_is_nothing_to_tell() -> None:
    assert quarters({}, {}, watched([])) == []
