"""Secrets of a cluster: the chart's own Redis asks for its password; what the kubelet lays out is read."""

import os
import subprocess
import time
from pathlib import Path

import pytest
from redis import AuthenticationError, Redis, RedisError

from services.runtime.settings import Settings
from testing.servers.process import free_port
from testing.servers.redis import _binary
from tests.deploy.kubernetes.rendering import containers, rendered

WITHIN_S = 20.0


def answering(port: int, password: str) -> Redis:
    client = Redis(port=port, password=password, socket_timeout=5)
    deadline_s = time.monotonic() + WITHIN_S
    while True:
        try:
            client.ping()
            return client
        except AuthenticationError:
            raise
        except RedisError:
            assert time.monotonic() < deadline_s, "Redis does not start"
            time.sleep(0.02)


def test_the_redis_of_the_chart_asks_for_the_password_of_the_secret(tmp_path: Path) -> None:
    [command] = [container["command"] for role, container in containers(rendered("small")) if role == "redis"]
    (tmp_path / "stone_broker__password").write_text("s3cret of 'redis'\n")
    (tmp_path / "redis-server").symlink_to(_binary())
    port = free_port()
    script = command[2].replace("/run/secrets", str(tmp_path)).replace("--dir /tmp", f"--dir {tmp_path} --port {port}")
    server = subprocess.Popen(
        ["/bin/sh", "-c", script],
        env={"PATH": f"{tmp_path}{os.pathsep}/bin:/usr/bin"},
        stdout=subprocess.DEVNULL,
        stdin=subprocess.DEVNULL,
    )
    try:
        client = answering(port, "s3cret of 'redis'")
        said = client.config_get("*")
        assert [said[name] for name in ("appendonly", "save", "maxmemory-policy")] == ["no", "", "noeviction"]
        assert "s3cret" not in Path(f"/proc/{server.pid}/cmdline").read_text()
        with pytest.raises(AuthenticationError):
            answering(port, "wrong")
    finally:
        server.terminate()  # it is Redis itself, since the shell became it
        assert server.wait(WITHIN_S) == 0


def laid_out(folder: Path, version: str, **secrets: str) -> None:
    """Write `secrets` as a new version of the volume at `folder`, and let the links mean it."""
    hidden = folder / f"..{version}"
    hidden.mkdir(parents=True)
    for name, text in secrets.items():
        (hidden / name).write_text(text)
        if not (folder / name).is_symlink():
            (folder / name).symlink_to(f"..data/{name}")
    fresh = folder / "..data_tmp"
    fresh.symlink_to(hidden.name)
    fresh.replace(folder / "..data")


def test_a_secret_of_a_cluster_is_read_and_a_changed_one_by_the_next_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STONE_SECRETS_DIR", str(tmp_path))
    monkeypatch.setenv("STONE_BROKER__URL", "redis://stone-redis:6379/0")
    laid_out(tmp_path, "2026_1", stone_database__password="old\n", stone_broker__password="p@ss/word")
    read = Settings()
    assert read.database.password.get_secret_value() == "old"
    assert read.broker.address == "redis://:p%40ss%2Fword@stone-redis:6379/0"
    laid_out(tmp_path, "2026_2", stone_database__password="new", stone_broker__password="other")
    assert Settings().database.password.get_secret_value() == "new"
    assert Settings().broker.password.get_secret_value() == "other"
