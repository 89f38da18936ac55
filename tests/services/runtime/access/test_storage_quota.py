"""The ledger of bytes: what is taken is given back once, and nobody takes the last bytes twice."""

from sqlalchemy import func, select

from services.runtime.access.storage_quota import balance, release, reserve
from services.runtime.orm import QuotaEntry, new_id
from services.runtime.platform import Platform
from testing.refusals import refused_as
from testing.threads import at_once, granted
from tests.services.runtime.jobs.steps import act
from tests.services.runtime.uploads.sending import make_owner


def taken(platform: Platform, owner_id: str) -> int:
    with platform.database.reading() as session:
        return balance(session, owner_id)


def test_more_than_the_limit_is_refused_and_takes_nothing(platform: Platform) -> None:
    owner = make_owner(platform)
    act(platform, reserve, owner.user_id, 70, "a", "upload", 100)
    with (
        refused_as("quota_exceeded", match="70 of 100"),
        platform.database.transaction() as session,
    ):
        reserve(session, owner.user_id, 31, "b", "upload", 100)
    assert taken(platform, owner.user_id) == 70


def test_what_is_given_back_twice_counts_once(platform: Platform) -> None:
    owner = make_owner(platform)
    with platform.database.transaction() as session:
        reserve(session, owner.user_id, 70, "a", "upload", 100)
        reserve(session, owner.user_id, 30, "b", "upload", 100)
    for expected in (70, 0):
        assert act(platform, release, "a", "terminated") == expected
    assert taken(platform, owner.user_id) == 30


def test_one_owner_does_not_count_against_another(platform: Platform) -> None:
    ada, bob = make_owner(platform), make_owner(platform, "bob")
    with platform.database.transaction() as session:
        reserve(session, ada.user_id, 100, "a", "upload", 100)
        reserve(session, bob.user_id, 100, "b", "upload", 100)
    assert taken(platform, bob.user_id) == 100


def test_concurrent_reservations_never_overshoot(platform_on: Platform) -> None:
    owner = make_owner(platform_on)

    def take(_number: int) -> None:
        act(platform_on, reserve, owner.user_id, 30, new_id(), "upload", 100)

    assert granted(8, take, "quota_exceeded") == 3
    assert taken(platform_on, owner.user_id) == 90


def test_concurrent_releases_of_one_subject_give_back_once(platform_on: Platform) -> None:
    owner = make_owner(platform_on)
    with platform_on.database.transaction() as session:
        reserve(session, owner.user_id, 30, "a", "upload", 100)
        reserve(session, owner.user_id, 50, "b", "upload", 100)

    def give_back(_number: int) -> int:
        return act(platform_on, release, "a", "expired")

    assert sorted(at_once(6, give_back)) == [0] * 5 + [30]
    assert taken(platform_on, owner.user_id) == 50
    with platform_on.database.reading() as session:
        assert session.scalar(select(func.count()).select_from(QuotaEntry)) == 3
