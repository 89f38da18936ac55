"""The broker: what it may tell a worker, wake-ups sent and taken back, a worker that listens on when Redis ends."""

import os
import signal
import socket
from collections.abc import Iterator
from pathlib import Path
from unittest.mock import Mock

import pytest
from kombu import Connection
from kombu.transport import redis
from redis import Redis
from redis.exceptions import ConnectionError as RedisConnectionError

from services.runtime.jobs import celery_app
from services.runtime.jobs.broker_app import make_app
from services.runtime.jobs.celery_app import app
from services.runtime.jobs.wakeup import wake_up_counter, wake_up_sender
from services.runtime.settings import BrokerSettings, Settings
from testing.servers.fixtures import make_settings
from testing.servers.redis import running_redis


def test_nobody_steers_or_watches_workers_by_the_broker() -> None:
    said = make_app(Settings()).conf
    assert not said.worker_enable_remote_control
    assert not said.worker_send_task_events
    assert not said.task_send_sent_event
    assert {*said.accept_content} == {"json"}, "what is unpickled may be anything"


@pytest.fixture
def channel(redis_url: str) -> Iterator[redis.Channel]:
    with Connection(redis_url) as connection:
        yield connection.default_channel


def full(channel: redis.Channel) -> redis.QoS:
    """With room for one wake-up, and one in it."""
    held = celery_app.WakeUpQoS(channel, 1)
    held.restore_at_shutdown = False
    held.append(Mock(delivery_info={"exchange": "", "routing_key": "ingest"}, _raw={}), "tag")
    assert not held.can_consume()
    return held


def away(*_: object) -> None:
    raise RedisConnectionError("Connection reset by peer")


def test_room_is_free_again_though_the_broker_went_away(
    channel: redis.Channel, monkeypatch: pytest.MonkeyPatch
) -> None:
    held = full(channel)
    monkeypatch.setattr(held, "_remove_from_indices", away)
    with pytest.raises(RedisConnectionError):
        held.ack("tag")
    assert held.can_consume()


def test_workers_hold_wake_ups_so() -> None:
    assert app.tasks is not None
    assert redis.Channel.QoS is celery_app.WakeUpQoS


def test_whoever_takes_a_job_without_a_wake_up_takes_one_back(redis_url: str, tmp_path: Path) -> None:
    Redis.from_url(redis_url).flushdb()
    settings = make_settings(tmp_path, broker=BrokerSettings(redis_url))
    send, waiting = wake_up_sender(settings), wake_up_counter(settings)
    send("ingest", 3)
    send("labeler", 1)
    send("ingest", -2)
    assert (waiting("ingest"), waiting("labeler")) == (1, 1)
    send("ingest", -5)
    assert (waiting("ingest"), waiting("labeler")) == (0, 1), "there are no more than there are"
    send("ingest", 1)
    assert waiting("ingest") == 1


def test_a_broker_that_is_away_is_no_error_and_is_not_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("kombu.utils.functional.sleep", lambda seconds: pytest.fail(f"waits {seconds:g} s"))
    send = wake_up_sender(make_settings(tmp_path, broker=BrokerSettings("redis://127.0.0.1:1/0")))
    send("ingest", 1)
    send("ingest", -1)


def test_a_hung_broker_holds_whoever_wakes_a_worker_for_two_seconds_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    waits: list[float | None] = []

    class Watched(socket.socket):
        def settimeout(self, value: float | None) -> None:
            waits.append(value)
            super().settimeout(value)

    with running_redis() as server:
        send = wake_up_sender(make_settings(tmp_path, broker=BrokerSettings(server.url)))
        os.kill(server.pid, signal.SIGSTOP)
        monkeypatch.setattr("socket.socket", Watched)
        send("ingest", 1)
        assert waits, "it was not even tried"
        assert max(wait or 999.0 for wait in waits) <= 2.0
        waits.clear()
        send("ingest", 1)
        assert not waits, "the next one waits too"
        os.kill(server.pid, signal.SIGCONT)
