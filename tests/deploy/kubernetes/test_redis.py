"""The chart's own Redis: its very command, run by a shell, asks for the password and keeps nothing."""

import os
import subprocess
import time
from pathlib import Path

import pytest
from redis import AuthenticationError, Redis, RedisError

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
