"""Parts of the embedded platform: a child is kept running and ends in bounded time; broker, lock, socket, logs."""

import json
import os
import signal
import socket
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path

import psutil
import pytest
from redis import AuthenticationError, Redis, RedisError

from services.runtime.embedded import redis_child
from services.runtime.embedded.child_process import KEPT, Child, Program, cut_if_large
from services.runtime.embedded.errors import PortTakenError
from services.runtime.embedded.listen_socket import LOCK, hold_folder, listen, local_url, reached_at, stop_holder
from services.runtime.embedded.redis_child import LOOK_S, MISSES, Broker, Pulse, start_redis
from services.runtime.embedded.supervisor import SupervisedChildren
from services.runtime.settings import ApiSettings
from testing.process_states import is_running
from testing.refusals import refused_as
from testing.stone_serve import until

FORKS = "import os, time; os.fork(); time.sleep(600)"
STUBBORN = (
    "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); print('deaf', flush=True); time.sleep(600)"
)
SUPERVISOR = """
import sys, time
from pathlib import Path
from services.runtime.embedded.child_process import Child, Program
import os
child = Child(Program("sleeper", ("sleep", "600"), os.environ, Path(sys.argv[1]), 1.0), Path(sys.argv[1]), print)
child.start()
print(child.pid, flush=True)
time.sleep(600)
"""


@pytest.fixture
def told() -> list[str]:
    return []


@pytest.fixture
def make(tmp_path: Path, told: list[str]) -> Iterator[Callable[..., Child]]:
    made: list[Child] = []

    def child(*argv: str, stop_s: float = 5.0) -> Child:
        made.append(Child(Program("sleeper", argv, os.environ, tmp_path, stop_s), tmp_path / "logs", told.append))
        return made[-1]

    yield child
    for each in made:
        each.kill()


def test_a_child_that_stands_back_leaves_processors_to_others(tmp_path: Path, told: list[str]) -> None:
    program = Program("sleeper", ("sleep", "600"), os.environ, tmp_path, 5.0, niceness=3)
    child = Child(program, tmp_path / "logs", told.append)
    child.start()
    try:
        assert psutil.Process(child.pid).nice() == psutil.Process().nice() + 3
    finally:
        child.kill()


def test_a_dead_child_is_started_again_after_a_pause_and_it_is_said(
    make: Callable[..., Child], told: list[str]
) -> None:
    child = make("sleep", "600")
    child.start()
    first = child.pid
    os.kill(first, signal.SIGKILL)
    until(lambda: child.exit_code is not None)
    child.revive()
    assert child.pid == first, "not at once"
    until(lambda: child.revive() or child.pid != first)
    assert is_running(child.pid)
    assert "SIGKILL" in told[0]


def test_a_child_that_keeps_dying_is_started_ever_more_rarely(make: Callable[..., Child], told: list[str]) -> None:
    child = make("false")
    child.start()
    until(lambda: child.revive() or sum("ended with exit code 1" in line for line in told) == 3)
    pauses = [line.partition(" restarted in ")[2].partition(" s")[0] for line in told if "ended" in line]
    assert pauses == ["0.5", "1", "2"]


def test_stopping_ends_what_the_child_forked_too(make: Callable[..., Child]) -> None:
    child = make(sys.executable, "-c", FORKS)
    child.start()
    until(lambda: len(psutil.Process(child.pid).children()) == 1)
    grandchild = psutil.Process(child.pid).children()[0].pid
    assert child.stop()
    until(lambda: not is_running(grandchild))


def test_a_child_that_does_not_listen_is_killed_when_its_time_is_up(make: Callable[..., Child]) -> None:
    child = make(sys.executable, "-c", STUBBORN, stop_s=0.2)
    child.start()
    until(lambda: "deaf" in child.log.read_text())
    assert not child.stop()
    assert child.exit_code == -signal.SIGKILL


def test_a_child_dies_with_its_supervisor_even_by_kill_9(tmp_path: Path) -> None:
    supervisor = subprocess.Popen([sys.executable, "-c", SUPERVISOR, tmp_path], stdout=subprocess.PIPE, text=True)
    assert supervisor.stdout is not None
    with supervisor.stdout:
        pid = int(supervisor.stdout.readline())
    assert is_running(pid)
    supervisor.kill()
    supervisor.wait()
    until(lambda: not is_running(pid))


@contextmanager
def running(folder: Path, told: list[str]) -> Iterator[Broker]:
    broker = start_redis(folder / "redis", folder / "logs", told.append)
    try:
        yield broker
    finally:
        broker.child.kill()


def test_nobody_without_the_password_is_let_in(tmp_path: Path) -> None:
    with running(tmp_path / "with spaces", []) as broker:
        port = int(broker.url.rpartition(":")[2].partition("/")[0])
        with Redis(port=port) as stranger, pytest.raises(AuthenticationError):
            stranger.ping()
        assert (tmp_path / "with spaces" / "redis" / "redis.conf").stat().st_mode & 0o077 == 0


def test_a_damaged_file_of_bells_is_moved_aside_and_said(tmp_path: Path) -> None:
    told: list[str] = []
    with running(tmp_path, told):
        pass
    (tmp_path / "redis" / "appendonly.aof").write_bytes(b"*1\r\n$-7\r\nnonsense, and not at the end\r\n" * 9)
    with running(tmp_path, told) as broker, Redis.from_url(broker.url) as client:
        assert client.ping()
    assert "moved aside" in told[0]
    assert any(".damaged." in entry.name for entry in (tmp_path / "redis").iterdir())


def test_a_redis_that_hangs_is_killed_and_one_that_answers_is_not(tmp_path: Path) -> None:
    told: list[str] = []
    with running(tmp_path, []) as broker:
        pulse, clock_s = Pulse(broker, told.append), count(step=LOOK_S)
        for _ in range(MISSES + 1):
            pulse.look(next(clock_s))
        assert broker.child.exit_code is None
        os.kill(broker.child.pid, signal.SIGSTOP)
        for _ in range(MISSES):
            assert broker.child.exit_code is None
            pulse.look(next(clock_s))
        assert broker.child.exit_code == -signal.SIGKILL
        broker.child.revive()
        until(lambda: broker.child.revive() or broker.child.exit_code is None)
    assert len(told) == 1
    assert "did not answer" in told[0]


def test_the_supervisor_starts_a_hung_redis_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(redis_child, "LOOK_S", 0.1)
    told: list[str] = []
    with running(tmp_path, told) as broker, Redis.from_url(broker.url) as client:
        supervised = SupervisedChildren((broker.child,), told.append, Pulse(broker, told.append))
        supervised.start()
        os.kill(broker.child.pid, signal.SIGSTOP)
        until(lambda: any("was restarted, process" in line for line in told))
        supervised.stop()
        until(lambda: is_answering(client))
        supervised.kill()


def is_answering(client: Redis) -> bool:
    try:
        return bool(client.ping())
    except RedisError:
        return False


def test_a_second_server_is_told_the_process_and_the_url(tmp_path: Path) -> None:
    with hold_folder(tmp_path / "the data") as lock:
        lock.say("http://127.0.0.1:8080")
        with (
            refused_as("already_serving", match=rf"{os.getpid()} .*http://127.0.0.1:8080"),
            hold_folder(tmp_path / "the data"),
        ):
            pass


def test_a_lock_that_nobody_holds_any_more_is_taken(tmp_path: Path) -> None:
    (tmp_path / LOCK).write_text('{"pid": 1, "url": "http://gone"}')
    with hold_folder(tmp_path):
        pass
    with hold_folder(tmp_path):
        pass


def test_a_lock_file_half_written_is_no_reason_to_fail_differently(tmp_path: Path) -> None:
    with hold_folder(tmp_path):
        (tmp_path / LOCK).write_text("{")
        with refused_as("already_serving"), hold_folder(tmp_path):
            pass


def test_a_new_data_folder_is_its_owners_only(tmp_path: Path) -> None:
    with hold_folder(tmp_path / "data"):
        assert stat.S_IMODE((tmp_path / "data").stat().st_mode) == 0o700


def test_a_taken_port_is_refused_by_name() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(PortTakenError, match=str(port)):
            listen(ApiSettings(port=port))


@pytest.mark.parametrize("host", ["192.0.2.1", "nowhere.invalid"])
def test_a_host_that_is_not_ours_is_refused(host: str) -> None:
    with pytest.raises(PortTakenError, match=host):
        listen(ApiSettings(host=host, port=0))


def test_port_0_becomes_the_port_that_was_free() -> None:
    with listen(ApiSettings(port=0)) as listener:
        api = reached_at(ApiSettings(port=0), listener)
        assert api.port == listener.getsockname()[1] > 0
        assert api.url == f"http://127.0.0.1:{api.port}"


@pytest.mark.parametrize(
    ("host", "url"),
    [("0.0.0.0", "http://127.0.0.1:80"), ("::", "http://[::1]:80"), ("robot", "http://robot:80")],
)
def test_a_server_that_listens_everywhere_is_reached_locally(host: str, url: str) -> None:
    assert local_url(host, 80) == url


def test_a_large_log_is_cut_while_its_writer_goes_on(tmp_path: Path) -> None:
    log = tmp_path / "api.log"
    with log.open("ab", buffering=0) as writer:
        for number in range(KEPT + 3):
            writer.write(b"%d " % number + b"x" * 100)
            assert cut_if_large(log, max_bytes=100)
        writer.write(b"after")
    assert log.read_bytes() == b"after"
    kept = sorted(path.name for path in tmp_path.iterdir())
    assert kept == ["api.log", *(f"api.log.{number}" for number in range(1, KEPT + 1))]
    assert (tmp_path / "api.log.1").read_bytes().startswith(b"%d " % (KEPT + 2))


HOLDING = """
import signal, sys
from pathlib import Path
from services.runtime.embedded.listen_socket import hold_folder
signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTERM])
with hold_folder(Path(sys.argv[1])) as lock:
    lock.say(sys.argv[2])
    print("held", flush=True)
    signal.sigwait([signal.SIGTERM])
"""


@contextmanager
def another_holder(folder: Path, url: str) -> Iterator[subprocess.Popen[str]]:
    """A process of its own that holds the folder until SIGTERM."""
    command = [sys.executable, "-c", HOLDING, str(folder), url]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        try:
            yield process
        finally:
            process.kill()


def test_the_server_of_a_folder_is_stopped_and_no_other(tmp_path: Path) -> None:
    with (
        another_holder(tmp_path / "a", "http://127.0.0.1:1") as ours,
        another_holder(tmp_path / "b", "http://127.0.0.1:2") as other,
    ):
        assert stop_holder(tmp_path / "a") == (ours.pid, "http://127.0.0.1:1")
        assert ours.wait(0) == 0, "the command waits for the end"
        assert other.poll() is None
        with refused_as("not_serving", match="no process uses it"):
            stop_holder(tmp_path / "a")


def test_only_a_server_is_stopped(tmp_path: Path) -> None:
    with refused_as("not_serving", match="not the data folder"):
        stop_holder(tmp_path)
    with another_holder(tmp_path / "restored", "") as restoring:
        with refused_as("not_serving", match="is still starting"):
            stop_holder(tmp_path / "restored")
        assert restoring.poll() is None
    (tmp_path / "stale").mkdir()
    (tmp_path / "stale" / LOCK).write_text(json.dumps({"pid": os.getpid(), "url": "http://127.0.0.1:3"}))
    with refused_as("not_serving", match="no process uses it"):
        stop_holder(tmp_path / "stale")
