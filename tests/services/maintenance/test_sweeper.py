"""The sweeper does each chore when it is due, waits outages out, and stops between two rounds."""

import pytest
from redis import ConnectionError as RedisConnectionError
from sqlalchemy.exc import OperationalError

from services.maintenance.sweeper import Chore, chores_of, sweep
from services.runtime.platform import Platform


def test_a_chore_is_done_when_it_is_due_and_not_before() -> None:
    done: list[str] = []
    chore = Chore("jobs", 10.0, lambda: done.append("jobs"))
    for now_s in (0.0, 5.0, 9.9, 10.0, 12.0):
        chore.run_if_due(now_s)
    assert len(done) == 2


@pytest.mark.parametrize(
    "outage", [OperationalError("BEGIN", {}, OSError("gone")), RedisConnectionError("gone"), OSError(28, "No space")]
)
def test_an_outage_is_waited_out(outage: Exception) -> None:
    outages = [outage]
    done: list[str] = []

    def work() -> None:
        if outages:
            raise outages.pop()
        done.append("jobs")

    chore = Chore("jobs", 10.0, work)
    assert not chore.run_if_due(0.0)
    assert chore.run_if_due(10.0)
    assert done == ["jobs"]


def test_a_fault_of_the_program_is_not_waited_out() -> None:
    def work() -> None:
        raise KeyError("a bug")

    with pytest.raises(KeyError):
        Chore("jobs", 10.0, work).run_if_due(0.0)


def test_sweeping_ends_when_told_between_two_rounds() -> None:
    rounds: list[int] = []
    sweep((Chore("jobs", 0.0, lambda: rounds.append(1)),), is_stopped=lambda: len(rounds) >= 3)
    assert len(rounds) == 3


def test_the_platform_without_a_broker_is_swept_all_the_same(platform: Platform) -> None:
    chores = chores_of(platform)
    often, seldom = (
        ["jobs", "submissions"],
        ["submitted files", "uploads", "blobs", "credentials", "audit log", "workers"],
    )
    assert [chore.name for chore in chores] == [*often, *seldom]
    assert all(chore.run_if_due(0.0) for chore in chores)
