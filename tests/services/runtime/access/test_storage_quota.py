"""The ledger of bytes: what is taken is given back once, and nobody takes the last bytes twice."""

from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import pytest
from sqlalchemy import func, select

from services.runtime.access.storage_quota import QuotaExceededError, balance, release, reserve
from services.runtime.orm import QuotaEntry, new_id
from services.runtime.platform import Platform
from tests.services.runtime.uploads.sending import make_owner


def taken(platform: Platform, owner_id: str) -> int:
    with platform.database.reading() as session:
        return balance(session, owner_id)


def test_more_than_the_limit_is_refused_and_takes_nothing(platform_on: Platform) -> None:
    owner = make_owner(platform_on)
    with platform_on.database.transaction() as session:
        reserve(session, owner.user_id, 70, "a", "upload", 100)
    with (
        pytest.raises(QuotaExceededError, match="70 of 100 bytes are used and 31 more"),
        platform_on.database.transaction() as session,
    ):
        reserve(session, owner.user_id, 31, "b", "upload", 100)
    assert taken(platform_on, owner.user_id) == 70


def test_the_limit_itself_may_be_reached(platform: Platform) -> None:
    owner = make_owner(platform)
    with platform.database.transaction() as session:
        reserve(session, owner.user_id, 100, "a", "upload", 100)
    assert taken(platform, owner.user_id) == 100


def test_a_rollback_takes_nothing(platform: Platform) -> None:
    owner = make_owner(platform)

    def take_and_fail() -> None:
        with platform.database.transaction() as session:
            reserve(session, owner.user_id, 10, "a", "upload", 100)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        take_and_fail()
    assert taken(platform, owner.user_id) == 0


def test_what_is_given_back_twice_counts_once(platform_on: Platform) -> None:
    owner = make_owner(platform_on)
    with platform_on.database.transaction() as session:
        reserve(session, owner.user_id, 70, "a", "upload", 100)
        reserve(session, owner.user_id, 30, "b", "upload", 100)
    for expected in (70, 0):
        with platform_on.database.transaction() as session:
            assert release(session, "a", "terminated") == expected
    assert taken(platform_on, owner.user_id) == 30


def test_one_owner_does_not_count_against_another(platform: Platform) -> None:
    ada, bob = make_owner(platform), make_owner(platform, "bob")
    with platform.database.transaction() as session:
        reserve(session, ada.user_id, 100, "a", "upload", 100)
        reserve(session, bob.user_id, 100, "b", "upload", 100)
    assert taken(platform, bob.user_id) == 100


def test_concurrent_reservations_never_overshoot(platform_on: Platform) -> None:
    owner, threads = make_owner(platform_on), 8
    together = Barrier(threads)

    def try_to_take(_number: int) -> bool:
        together.wait(timeout=300)
        try:
            with platform_on.database.transaction() as session:
                reserve(session, owner.user_id, 30, new_id(), "upload", 100)
        except QuotaExceededError:
            return False
        return True

    with ThreadPoolExecutor(threads) as pool:
        granted = list(pool.map(try_to_take, range(threads)))
    assert sum(granted) == 3
    assert taken(platform_on, owner.user_id) == 90


def test_concurrent_releases_of_one_subject_give_back_once(platform_on: Platform) -> None:
    owner, threads = make_owner(platform_on), 6
    with platform_on.database.transaction() as session:
        reserve(session, owner.user_id, 30, "a", "upload", 100)
        reserve(session, owner.user_id, 50, "b", "upload", 100)
    together = Barrier(threads)

    def give_back(_number: int) -> int:
        together.wait(timeout=300)
        with platform_on.database.transaction() as session:
            return release(session, "a", "expired")

    with ThreadPoolExecutor(threads) as pool:
        assert sorted(pool.map(give_back, range(threads))) == [0] * (threads - 1) + [30]
    assert taken(platform_on, owner.user_id) == 50
    with platform_on.database.reading() as session:
        assert session.scalar(select(func.count()).select_from(QuotaEntry)) == 3
