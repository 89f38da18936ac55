"""Whoever guesses passwords waits twice as long each time; whoever knows theirs does not."""

import pytest
from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.access import login_throttle
from services.runtime.access.passwords import refuse_guessable
from services.runtime.access.users import change_password, create_user, find_user
from services.runtime.orm import FailedSignInRow, SignInAddress
from services.runtime.platform import Platform
from testing.refusals import refused_as
from testing.threads import at_once

HERE = {"name": "ada", "address": "address 10.0.0.1"}
ELSEWHERE = "address 10.0.0.2"


def tried(platform: Platform, **told: str) -> float:
    with platform.database.transaction() as session:
        return login_throttle.count_try(session, login_throttle.try_at(session, **(HERE | told)))


def signed_in(platform: Platform, **told: str) -> None:
    with platform.database.transaction() as session:
        user = find_user(session, "ada") or create_user(session, "ada", "curator")
        login_throttle.take_back(session, login_throttle.try_at(session, **(HERE | told)), user.id)


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


def test_beyond_a_few_each_wrong_password_doubles_the_wait(platform: Platform, clock: Clock) -> None:
    exhausted(platform)
    for expected_s in (1, 2, 4, 8):
        assert tried(platform) == expected_s
        assert tried(platform) == expected_s, "asking again while waiting costs nothing"
        clock.wind(expected_s)
        assert tried(platform) == 0


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


def test_the_right_password_forgets_the_wrong_ones(platform: Platform, clock: Clock) -> None:
    exhausted(platform)
    clock.wind(1)
    assert tried(platform) == 0
    signed_in(platform)
    assert tried(platform, address=ELSEWHERE) == 0
    with platform.database.reading() as session:
        assert sorted(session.scalars(select(FailedSignInRow.failures))) == [1, 1, login_throttle.FREE["name"]]


def test_nobody_elses_wrong_passwords_shut_out_an_address_that_signed_in_before(
    platform: Platform, clock: Clock
) -> None:
    signed_in(platform)
    for number in range(3 * login_throttle.FREE["name"]):  # from many addresses, so that the name alone waits
        tried(platform, address=f"address 10.1.0.{number}")
    for number in range(login_throttle.FREE["address"] + 1):  # and whoever else is behind this one
        tried(platform, name=f"neighbour {number}")
    assert tried(platform, address=ELSEWHERE) > 0, "the name waits for whoever is not known"
    assert tried(platform, name="grace") > 0, "and so does the address"
    assert tried(platform) == 0
    signed_in(platform)
    assert tried(platform, address=ELSEWHERE) > 0, "nor does signing in there give a guesser new tries"


def test_who_guesses_from_a_known_address_waits_as_everywhere(platform: Platform, clock: Clock) -> None:
    signed_in(platform)
    exhausted(platform)
    for expected_s in (1, 2, 4):
        assert tried(platform) == expected_s
        clock.wind(expected_s)
        assert tried(platform) == 0


def test_an_address_is_forgotten_with_the_password_after_its_time_and_beyond_the_most(
    platform: Platform, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(login_throttle, "MOST_ADDRESSES", 2)
    for number in (1, 2, 3):
        clock.wind(1)
        signed_in(platform, address=f"address 10.2.0.{number}")
    assert known(platform) == [False, True, True]
    clock.wind(login_throttle.ADDRESSES_KEPT_NS / 1e9 - 1)
    assert known(platform) == [False, False, True]
    with platform.database.transaction() as session:
        user = find_user(session, "ada")
        assert user is not None
        change_password(session, user, "")
    assert known(platform) == [False, False, False]


def known(platform: Platform) -> list[bool]:
    with platform.database.reading() as session:
        return [login_throttle.try_at(session, "ada", f"address 10.2.0.{number}").is_known for number in (1, 2, 3)]


def test_a_day_without_a_wrong_password_forgets_all(platform: Platform, clock: Clock) -> None:
    exhausted(platform)
    clock.wind(86_401)
    for _ in range(login_throttle.FREE["name"]):
        assert tried(platform) == 0


def test_many_at_once_buy_no_more_than_one_after_another(platform_on: Platform) -> None:
    count = 2 * login_throttle.FREE["name"]
    assert at_once(count, lambda _: tried(platform_on)).count(0) == login_throttle.FREE["name"]


def test_rows_tell_nobodys_name_or_address(platform: Platform) -> None:
    tried(platform)
    signed_in(platform)
    with platform.database.reading() as session:
        assert _all_text(session).isdisjoint(HERE.values())


def _all_text(session: Session) -> set[str]:
    rows = (*session.scalars(select(FailedSignInRow)), *session.scalars(select(SignInAddress)))
    return {str(value) for row in rows for value in vars(row).values()}


@pytest.mark.parametrize(
    "password",
    [
        *("dragon123456", "Password1234!", "monkeymonkey99", "abcabcabcabc", "qwertyuiopas", "98765432109876"),
        *("grace.hopper1906", "Stone-Platform-2026"),
    ],
)
def test_what_would_be_tried_first_is_no_password(password: str) -> None:
    with refused_as("guessable_password"):
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
