"""Whoever guesses passwords waits twice as long each time; whoever knows theirs does not."""

import threading

import pytest
from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.access import login_throttle
from services.runtime.access.errors import GuessablePasswordError
from services.runtime.access.weak_passwords import refuse_guessable
from services.runtime.orm import FailedSignInRow
from services.runtime.platform import Platform

HERE = {"name": "ada", "address": "address 10.0.0.1"}


def tried(platform: Platform, **told: str) -> float:
    with platform.database.transaction() as session:
        return login_throttle.count_try(session, **(HERE | told))


class Clock:
    """A wall clock that a test winds."""

    def __init__(self) -> None:
        self.now_ns = 1_790_000_000 * 10**9

    def __call__(self) -> int:
        return self.now_ns

    def wind(self, seconds: float) -> None:
        self.now_ns += int(seconds * 1e9)


@pytest.fixture(autouse=True)
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(login_throttle, "now_ns", made)
    return made


def exhausted(platform: Platform) -> None:
    for _ in range(login_throttle.FREE["name"]):
        assert tried(platform) == 0


def test_beyond_a_few_each_wrong_password_doubles_the_wait(platform_on: Platform, clock: Clock) -> None:
    exhausted(platform_on)
    for expected_s in (1, 2, 4, 8):
        assert tried(platform_on) == expected_s
        assert tried(platform_on) == expected_s, "asking again while waiting costs nothing"
        clock.wind(expected_s)
        assert tried(platform_on) == 0


@pytest.mark.parametrize("kind", sorted(login_throttle.FREE))
def test_nobody_gets_a_hundred_tries_in_an_hour_nor_waits_longer_than_said(kind: str) -> None:
    at_s, tries = 0.0, 0
    while at_s < 3600:
        tries += 1
        at_s += (pause := login_throttle.pause_s(kind, tries))
        assert pause <= login_throttle.LONGEST_WAIT_S
    assert tries < 100
    assert login_throttle.pause_s(kind, 10**6) == login_throttle.LONGEST_WAIT_S


def test_another_name_or_address_is_counted_by_itself(platform: Platform) -> None:
    exhausted(platform)
    assert tried(platform) > 0
    assert tried(platform, address="address 10.0.0.2") > 0, "the name waits wherever it is tried from"
    assert tried(platform, name="eve") == 0


def test_the_right_password_forgets_the_wrong_ones(platform_on: Platform, clock: Clock) -> None:
    exhausted(platform_on)
    clock.wind(1)
    assert tried(platform_on) == 0
    with platform_on.database.transaction() as session:
        login_throttle.take_back(session, **HERE)
    assert tried(platform_on) == 0
    with platform_on.database.reading() as session:
        assert sorted(session.scalars(select(FailedSignInRow.failures))) == [1, login_throttle.FREE["name"] + 1]


def test_a_day_without_a_wrong_password_forgets_all(platform: Platform, clock: Clock) -> None:
    exhausted(platform)
    clock.wind(86_401)
    for _ in range(login_throttle.FREE["name"]):
        assert tried(platform) == 0


def test_many_at_once_buy_no_more_than_one_after_another(platform_on: Platform) -> None:
    at_once = 2 * login_throttle.FREE["name"]
    admitted: list[float] = []
    barrier = threading.Barrier(at_once)

    def one() -> None:
        barrier.wait(300)
        admitted.append(tried(platform_on))

    threads = [threading.Thread(target=one) for _ in range(at_once)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert admitted.count(0) == login_throttle.FREE["name"]


def test_rows_tell_nobodys_name_or_address(platform: Platform) -> None:
    tried(platform)
    with platform.database.reading() as session:
        assert _all_text(session).isdisjoint(HERE.values())


def _all_text(session: Session) -> set[str]:
    return {str(value) for row in session.scalars(select(FailedSignInRow)) for value in vars(row).values()}


@pytest.mark.parametrize(
    ("password", "reason"),
    [
        ("dragon123456", "commonest"),
        ("Password1234!", "commonest"),
        ("monkeymonkey99", "commonest"),
        ("abcabcabcabc", "only 3 different"),
        ("qwertyuiopas", "a run"),
        ("98765432109876", "a run"),
        ("grace.hopper1906", "name of its user"),
        ("Stone-Platform-2026", "of this platform"),
    ],
)
def test_what_would_be_tried_first_is_no_password(password: str, reason: str) -> None:
    with pytest.raises(GuessablePasswordError, match=reason):
        refuse_guessable(password, "grace.hopper")


@pytest.mark.parametrize(
    "password",
    ["correct horse battery staple", "x8Fj2-_pQQm1Zr", "übermorgen fällt Schnee", "🦊" * 3 + "a winter's tale"],
)
def test_what_nobody_would_try_is_one(password: str) -> None:
    refuse_guessable(password, "grace.hopper")


def test_a_laboratory_behind_one_address_has_fifty_tries_and_one_name_ten() -> None:
    assert [login_throttle.pause_s("address", failures) for failures in (49, 50, 51)] == [0, 1, 2]
    assert [login_throttle.pause_s("name", failures) for failures in (9, 10, 11)] == [0, 1, 2]
