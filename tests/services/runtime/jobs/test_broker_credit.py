"""A worker goes on listening when Redis ends in the moment in which it acknowledges."""

from collections.abc import Iterator
from unittest.mock import Mock

import pytest
from kombu import Connection
from kombu.transport import redis
from redis.exceptions import ConnectionError as RedisConnectionError

from services.runtime.jobs import broker_credit
from services.runtime.jobs.celery_app import app


@pytest.fixture
def channel(redis_url: str) -> Iterator[redis.Channel]:
    with Connection(redis_url) as connection:
        yield connection.default_channel


def full(channel: redis.Channel, kind: type[redis.QoS]) -> redis.QoS:
    """With room for one wake-up, and one in it."""
    held = kind(channel, 1)
    held.restore_at_shutdown = False
    held.append(Mock(delivery_info={"exchange": "", "routing_key": "ingest"}, _raw={}), "tag")
    assert not held.can_consume()
    return held


def away(*_: object) -> None:
    raise RedisConnectionError("Connection reset by peer")


@pytest.mark.parametrize(("kind", "is_free"), [(redis.QoS, False), (broker_credit.WakeUpQoS, True)])
def test_room_is_free_again_though_the_broker_went_away(
    channel: redis.Channel, kind: type[redis.QoS], is_free: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    held = full(channel, kind)
    monkeypatch.setattr(held, "_remove_from_indices", away)
    with pytest.raises(RedisConnectionError):
        held.ack("tag")
    assert held.can_consume() == is_free


def test_an_acknowledgement_that_is_heard_frees_room_once(channel: redis.Channel) -> None:
    held = full(channel, broker_credit.WakeUpQoS)
    held.ack("tag")
    assert held.can_consume()
    held.append(Mock(delivery_info={"exchange": "", "routing_key": "ingest"}, _raw={}), "next")
    assert not held.can_consume()


def test_workers_hold_wake_ups_so() -> None:
    assert app.tasks is not None
    assert redis.Channel.QoS is broker_credit.WakeUpQoS
