"""Wake-ups in a real broker: as many are sent or taken back as jobs became ready or were taken without one."""

from pathlib import Path

import pytest
from redis import Redis

from services.runtime.jobs.wakeup import wake_up_counter, wake_up_sender
from services.runtime.settings import BrokerSettings
from testing.servers.fixtures import make_settings


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
