"""How often: per caller or address, with the seconds to wait, in bounded memory."""

from dataclasses import replace

import httpx
import pytest
from fastapi import Request
from hypothesis import given
from hypothesis import strategies as st

from api.middleware import limits
from api.middleware.limits import Buckets, RequestLimits, address_of, credential_of
from services.runtime.access.login_throttle import SignInTry
from services.runtime.platform import Platform
from services.runtime.settings import ApiSettings, Settings
from testing.api.serving import Person, client_of
from testing.refusals import refused_as


class Clock:
    """A monotonic clock that a test winds."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


def request(host: str = "10.0.0.1", **headers: str) -> Request:
    raw = [(name.encode(), value.encode("latin-1")) for name, value in headers.items()]
    return Request({"type": "http", "method": "GET", "path": "/", "headers": raw, "client": (host, 1)})


def strict(**rates: int) -> Settings:
    return Settings(api=ApiSettings(**rates))


def with_rate(platform: Platform, per_minute: int) -> Platform:
    api = ApiSettings(requests_per_minute=per_minute)
    return replace(platform, settings=platform.settings.model_copy(update={"api": api}))


@given(st.lists(st.floats(0, 30), max_size=60), st.integers(1, 20))
def test_no_minute_admits_more_than_its_bucket_and_what_filled_it(pauses_s: list[float], per_minute: int) -> None:
    clock = Clock()
    buckets = Buckets(clock)
    admitted_s: list[float] = []
    for pause_s in pauses_s:
        clock.now_s += pause_s
        if not buckets.take("k", per_minute):
            admitted_s.append(clock.now_s)
    for begin_s in admitted_s:
        in_minute = [at_s for at_s in admitted_s if begin_s <= at_s < begin_s + 60]
        assert len(in_minute) <= 2 * per_minute


@given(st.integers(1, 100))
def test_waiting_as_long_as_told_is_enough(per_minute: int) -> None:
    clock = Clock()
    buckets = Buckets(clock)
    while not (wait_s := buckets.take("k", per_minute)):
        pass
    clock.now_s += wait_s * 0.5
    assert buckets.take("k", per_minute) > 0
    clock.now_s += wait_s * 0.5 + 1e-6
    assert buckets.take("k", per_minute) == 0


def test_a_clock_that_stands_still_admits_no_more_than_the_bucket() -> None:
    buckets = Buckets(Clock())
    assert sum(not buckets.take("k", 5) for _ in range(50)) == 5


def test_buckets_are_bounded_and_those_used_last_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "MOST_BUCKETS", 3)
    buckets = Buckets(Clock())
    buckets.take("mine", 1)
    for key in ("a", "b"):
        buckets.take(key, 1)
        assert buckets.take("mine", 1) > 0, "still empty"
    for key in ("c", "d", "e"):
        buckets.take(key, 1)
    assert buckets.take("mine", 1) == 0, "forgotten"
    assert len(buckets._held) == 3


@pytest.mark.parametrize(
    ("host", "expected"),
    [
        ("10.0.0.1", "address 10.0.0.1"), ("::ffff:10.0.0.1", "address 10.0.0.1"),
        ("2001:db8:1:2:3:4:5:6", "address 2001:db8:1:2::/64"), ("2001:db8:1:2::1", "address 2001:db8:1:2::/64"),
        ("", "address "), ("/run/socket", "address /run/socket"),
    ],
)  # fmt: skip
def test_an_address_counts_as_one_house(host: str, expected: str) -> None:
    assert address_of(request(host)) == expected


def test_inventing_tokens_buys_no_more_requests() -> None:
    limiting = RequestLimits(strict(requests_per_minute=3), Clock())
    for number in range(3):
        limiting.admit(request(authorization=f"Bearer {number}"))
    with refused_as("rate_limited", match="more than 3 requests a minute"):
        limiting.admit(request(authorization="Bearer 4"))
    limiting.admit(request("10.0.0.2", authorization="Bearer 4"))


def test_a_known_caller_is_counted_apart_from_their_address_and_over_all_their_tokens() -> None:
    limiting = RequestLimits(strict(requests_per_minute=2), Clock())
    for secret in ("one", "two"):
        limiting.know(request(authorization=secret), "ada")
    for secret in ("one", "two"):
        limiting.admit(request(authorization=secret))
    with refused_as("rate_limited"):
        limiting.admit(request("10.0.0.9", authorization="one"))
    limiting.admit(request())


def test_sign_ins_are_counted_by_address_and_by_name() -> None:
    limiting = RequestLimits(strict(sign_ins_per_minute=2), Clock())
    for _ in range(2):
        limiting.admit_sign_in(request(), SignInTry("ada", ""))
    with refused_as("rate_limited"):
        limiting.admit_sign_in(request(), SignInTry("eve", ""))
    for number in range(4):
        limiting.admit_sign_in(request(f"10.0.1.{number}"), SignInTry("ada", ""))
    with refused_as("rate_limited", match="more than 6 requests a minute"):
        limiting.admit_sign_in(request("10.0.2.1"), SignInTry("ada", ""))
    limiting.admit_sign_in(request("10.0.2.1"), SignInTry("bob", ""))


def test_a_secret_is_not_kept_in_memory() -> None:
    assert "stone_secret" not in credential_of(request(authorization="Bearer stone_secret"))


def test_known_credentials_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "MOST_BUCKETS", 3)
    limiting = RequestLimits(strict(), Clock())
    for number in range(10):
        limiting.know(request(authorization=f"Bearer {number}"), f"user {number}")
    assert len(limiting._known) == 3


@pytest.fixture
def _standing(monkeypatch: pytest.MonkeyPatch) -> None:
    """However slow the machine, no bucket of the application fills meanwhile."""
    monkeypatch.setattr("api.main.RequestLimits", lambda settings: RequestLimits(settings, Clock()))


@pytest.mark.usefixtures("_standing")
def test_too_many_requests_are_429_with_the_seconds_to_wait(platform: Platform, curator: Person) -> None:
    with client_of(with_rate(platform, 5)) as api:
        statuses = [api.get("/api/v1/problems").status_code for _ in range(6)]
        assert statuses == [200] * 5 + [429]
        refused = api.get("/api/v1/me", headers=curator.headers)
        assert (refused.status_code, refused.json()["code"]) == (429, "rate_limited")
        assert refused.headers["content-type"] == "application/problem+json"
        assert 1 <= int(refused.headers["retry-after"]) <= 12
        assert api.get("/healthz").status_code == 200, "probes are not counted"


@pytest.mark.usefixtures("_standing")
def test_a_caller_is_not_slowed_by_their_neighbours(platform: Platform, curator: Person) -> None:
    with client_of(with_rate(platform, 5)) as api:
        assert api.get("/api/v1/me", headers=curator.headers).status_code == 200
        neighbours: list[httpx.Response] = [api.get("/api/v1/me") for _ in range(6)]
        assert [answer.status_code for answer in neighbours] == [401] * 4 + [429] * 2
        assert api.get("/api/v1/me", headers=curator.headers).status_code == 200
