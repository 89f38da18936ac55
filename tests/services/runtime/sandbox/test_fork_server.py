"""Children of a service come from a process without secrets: what they can read, and what happens when anyone dies."""

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from secrets import token_hex

import pytest

import services
from services.runtime.sandbox import SandboxLimits, fences, fork_client, sandboxed
from services.runtime.sandbox.errors import SandboxCrashedError, SandboxInterruptedError
from services.runtime.sandbox.fork_client import ForkServer, harmless
from services.runtime.sandbox.system_files import PACKAGES
from services.runtime.telemetry.process_usage import used_cpu_s
from stone.errors import StoneError
from testing.process_states import is_running, parent_of
from testing.stone_serve import PATIENCE_S, until
from tests.services.runtime.sandbox import spies

SPIES = (spies.__name__,)
ASKER = """
import sys
from functools import partial
from pathlib import Path
from services.runtime.sandbox import SandboxLimits, sandboxed
from services.runtime.sandbox.fork_client import use_fork_server
from tests.services.runtime.sandbox import spies
told = Path(sys.argv[1])
use_fork_server([spies.__name__])
sandboxed(partial(spies.sleep, told), SandboxLimits(folder=told.parent, file_bytes=100))
"""
needs_landlock = pytest.mark.skipif(fences.version() == 0, reason="this kernel has no Landlock")


@pytest.fixture(scope="module")
def secret() -> Iterator[str]:
    """In this process's memory and environment, as the key of a store is."""
    made = f"stone-secret-{token_hex(16)}"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("STONE_STORE__S3_SECRET", made)
        patch.setenv("AWS_SECRET_ACCESS_KEY", made)
        yield made


@pytest.fixture(scope="module")
def started(secret: str) -> Iterator[ForkServer]:
    made = ForkServer(SPIES)
    yield made
    made.close()


@pytest.fixture
def server(started: ForkServer, monkeypatch: pytest.MonkeyPatch) -> ForkServer:
    monkeypatch.setattr(fork_client, "_SERVERS", [started])
    return started


def test_a_child_holds_no_secret_of_the_service(server: ForkServer, secret: str) -> None:
    assert secret.encode() not in sandboxed(spies.environment)
    assert sandboxed(spies.secrets_in_memory) == b""


@pytest.mark.whole
def test_a_child_of_the_service_itself_would_hold_them_all(secret: str) -> None:
    """So the check above can fail."""
    assert secret.encode() in sandboxed(spies.environment)
    assert secret.encode() in sandboxed(spies.secrets_in_memory)


@needs_landlock
def test_a_child_reads_what_it_is_given_and_the_systems_own_files(server: ForkServer, tmp_path: Path) -> None:
    given, another = tmp_path / "given", tmp_path / "another"
    for path in (given, another):
        path.write_text("a recording")
    asked = (
        given, another, tmp_path, Path("/etc/shadow"), Path("/etc/passwd"), Path("/root"), Path("/proc"),
        Path(f"/proc/{os.getpid()}/environ"), Path(f"/proc/{os.getpid()}/mem"), Path(f"/proc/{os.getpid()}/fd"),
        Path(sys.prefix).parent / "pyproject.toml",
    )  # fmt: skip
    limits = SandboxLimits(reads=(given,))
    assert sandboxed(partial(spies.readable, asked), limits).decode() == str(given)


@needs_landlock
def test_a_child_finds_a_package_though_the_folder_of_the_packages_changed(server: ForkServer) -> None:
    """Python looks into a folder again that changed, and a child may not."""
    assert sandboxed(spies.environment)  # the server has looked
    beside = Path(services.__file__ or "").parent.parent / f".changed-{token_hex(4)}"
    beside.touch()
    beside.unlink()
    for name in PACKAGES:
        assert sandboxed(partial(spies.late_package, name)) == name.encode()


def test_harmless_variables_are_a_list_of_what_passes() -> None:
    kept = {"PATH": "/bin", "LC_ALL": "C", "NUMBA_CACHE_DIR": "/data/numba", "OMP_NUM_THREADS": "1"}
    secret = {"STONE_DATABASE__PASSWORD": "x", "AWS_SECRET_ACCESS_KEY": "x", "PGPASSWORD": "x", "TOKEN": "x"}
    assert harmless({**kept, **secret}) == kept


def test_what_the_kernel_kills_is_a_crash_with_its_signal(server: ForkServer, tmp_path: Path) -> None:
    limits = SandboxLimits(folder=tmp_path, file_bytes=2**20)
    with pytest.raises(SandboxCrashedError, match="SIGBUS"):
        sandboxed(partial(spies.bus_error, tmp_path), limits)
    assert sandboxed(spies.reachable) == b"nothing", "the server forks on"


def test_what_children_use_is_counted_as_ours(server: ForkServer) -> None:
    before = used_cpu_s()
    sandboxed(partial(spies.spin, 0.4))
    assert used_cpu_s() - before >= 0.4


def test_a_server_that_was_killed_is_started_again(server: ForkServer) -> None:
    first = sandboxed(spies.parent)
    os.kill(int(first), signal.SIGKILL)
    until(lambda: not is_running(int(first)))
    assert sandboxed(spies.parent) != first


def test_work_that_is_lost_with_its_server_is_tried_again_and_not_refused(server: ForkServer, tmp_path: Path) -> None:
    told, raised = tmp_path / "told", list[StoneError]()
    limits = SandboxLimits(folder=tmp_path, file_bytes=100)

    def work() -> None:
        try:
            sandboxed(partial(spies.sleep, told), limits)
        except StoneError as error:
            raised.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    until(lambda: told.exists() and told.read_text() != "")
    child = int(told.read_text())
    parent = parent_of(child)
    os.kill(parent, signal.SIGKILL)
    thread.join(PATIENCE_S)
    assert [type(error) for error in raised] == [SandboxInterruptedError]
    until(lambda: not is_running(child))


def test_a_server_that_ends_at_once_is_a_fault_of_the_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    server = ForkServer(("no_such_module",))
    monkeypatch.setattr(fork_client, "_SERVERS", [server])
    with pytest.raises(SandboxInterruptedError):
        sandboxed(spies.reachable)
    server.close()


def test_work_that_no_other_process_can_be_given_is_said_at_once(server: ForkServer) -> None:
    with pytest.raises((AttributeError, TypeError), match="pickle"):
        sandboxed(lambda: b"")


@pytest.mark.parametrize("death", [signal.SIGKILL, signal.SIGTERM])
def test_children_and_server_end_with_the_service(tmp_path: Path, death: int) -> None:
    told = tmp_path / "told"
    asker = subprocess.Popen([sys.executable, "-c", ASKER, str(told)])
    until(lambda: told.exists() and told.read_text() != "")
    child = int(told.read_text())
    server = parent_of(child)
    os.kill(asker.pid, death)
    asker.wait()
    until(lambda: not is_running(child) and not is_running(server))
