"""A parser in the hands of whoever wrote the file reaches nothing: no network, no process, no file, no signal."""

import ctypes
import os
import resource
import signal
import socket
import subprocess
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
import structlog

from services.runtime.sandbox import SandboxLimits, fences, fork_client, parent, sandboxed, seccomp
from services.runtime.sandbox.errors import SandboxCrashedError, SandboxInterruptedError
from services.runtime.sandbox.fork_client import use_fork_server
from services.runtime.sandbox.system_calls import MACHINES
from testing.system_calls import system_call

Attack = Callable[[Path], object]
REFUSED = "raised PermissionError"


needs_seccomp = pytest.mark.skipif(
    not seccomp.is_known(), reason="this kernel or its container takes no seccomp filter"
)
needs_landlock = pytest.mark.skipif(fences.version() == 0, reason="this kernel has no Landlock")


def send_away(_: Path) -> None:
    socket.socket(socket.AF_INET, socket.SOCK_DGRAM).sendto(b"secret", ("127.0.0.1", 9))


def raise_the_limits(_: Path) -> None:
    limits = (ctypes.c_uint64 * 2)(2**63, 2**63)
    system_call("prlimit64", 0, resource.RLIMIT_NOFILE, ctypes.addressof(limits), 0)


def write_memory(_: Path) -> None:
    Path("/proc/self/mem").open("r+b").close()


ATTACKS: dict[str, Attack] = {
    "a connection": lambda _: socket.create_connection(("127.0.0.1", 9)),
    "a datagram": send_away,
    "a local socket": lambda _: socket.socket(socket.AF_UNIX),
    "a pair of sockets that are not local": lambda _: system_call("socketpair", socket.AF_INET, 1, 0, 0),
    "a newer connection": lambda _: socket.socket(socket.AF_INET6),
    "a packet": lambda _: system_call("socket", socket.AF_PACKET, socket.SOCK_RAW, 0),
    "the audit's socket": lambda _: system_call("socket", socket.AF_NETLINK, socket.SOCK_RAW, 9),
    "a fork": lambda _: os.fork(),
    "a fork by clone": lambda _: system_call("clone", signal.SIGCHLD, 0, 0, 0, 0),
    "another program": lambda _: os.execv("/bin/sh", ["sh", "-c", "true"]),
    "a spawned program": lambda _: subprocess.run(["true"], check=True),
    "a signal to the parent": lambda _: os.kill(os.getppid(), signal.SIGTERM),
    "a signal to everybody": lambda _: os.kill(-1, signal.SIGTERM),
    "the parent's memory": lambda _: system_call("process_vm_readv", os.getppid(), 0, 0, 0, 0, 0),
    "a debugger": lambda _: system_call("ptrace", 16, os.getppid(), 0, 0),
    "a file": lambda folder: (folder / "dropped").write_bytes(b"more"),
    "a file made longer": lambda folder: (folder / "standing").open("ab").close(),
    "a file cut off": lambda folder: os.truncate(folder / "standing", 0),
    "a file removed": lambda folder: (folder / "standing").unlink(),
    "a file renamed": lambda folder: (folder / "standing").rename(folder / "elsewhere"),
    "a folder": lambda folder: (folder / "made").mkdir(),
    "a link": lambda folder: (folder / "link").symlink_to("/etc/passwd"),
    "a mode": lambda folder: (folder / "standing").chmod(0o777),
    "an owner": lambda folder: os.chown(folder / "standing", 1, 1),
    "its own memory as a file": write_memory,
    "higher limits": raise_the_limits,
    "a mount": lambda _: system_call("mount", 0, 0, 0, 0, 0),
    "another user": lambda _: system_call("setuid", 0),
    "a namespace": lambda _: system_call("unshare", 0x10000000),
    "io_uring": lambda _: system_call("io_uring_setup", 8, 0),
}


def attacked(attack: Attack, folder: Path = Path()) -> bytes:
    attack(folder)
    return b"it went through"


@pytest.mark.whole
@needs_seccomp
@pytest.mark.parametrize("attack", ATTACKS)
def test_a_parser_that_attacks_is_refused_by_the_kernel_and_is_not_tried_again(attack: str, tmp_path: Path) -> None:
    (tmp_path / "standing").write_bytes(b"stays")
    before = sorted(tmp_path.iterdir())
    with pytest.raises(SandboxCrashedError, match=REFUSED):
        sandboxed(lambda: attacked(ATTACKS[attack], tmp_path))
    assert (sorted(tmp_path.iterdir()), (tmp_path / "standing").read_bytes()) == (before, b"stays")


@needs_seccomp
def test_a_fork_bomb_is_one_process_that_gives_up() -> None:
    def bomb() -> bytes:
        made = 0
        for _ in range(100):
            try:
                os.fork()
                made += 1
            except PermissionError:
                continue
        return str(made).encode()

    assert sandboxed(bomb) == b"0"


@needs_seccomp
@pytest.mark.parametrize("attack", ["a connection", "a fork", "another program", "an owner", "a signal to the parent"])
def test_a_child_with_a_folder_reaches_no_further_than_one_without(attack: str, tmp_path: Path) -> None:
    (tmp_path / "standing").touch()
    with pytest.raises(SandboxCrashedError, match=REFUSED):
        sandboxed(lambda: attacked(ATTACKS[attack], tmp_path), SandboxLimits(folder=tmp_path, file_bytes=10))


@needs_landlock
def test_a_child_writes_in_its_folder_and_nowhere_else(tmp_path: Path) -> None:
    own, foreign = tmp_path / "own", tmp_path / "foreign"
    own.mkdir()
    foreign.mkdir()
    (foreign / "standing").write_bytes(b"stays")

    def work() -> bytes:
        (own / "staging").write_bytes(b"ten bytes!")
        (own / "below").mkdir()
        (own / "staging").rename(own / "below" / "whole")
        return (foreign / "standing").read_bytes()

    limits = SandboxLimits(folder=own, file_bytes=10, reads=(foreign,), makes_links=True)
    assert sandboxed(work, limits) == b"stays"
    assert (own / "below" / "whole").read_bytes() == b"ten bytes!"
    for attack in ("a file", "a file made longer", "a file removed", "a folder", "a link", "a file renamed"):
        with pytest.raises(SandboxInterruptedError, match="PermissionError"):
            sandboxed(lambda attack=attack: attacked(ATTACKS[attack], foreign), limits)  # type: ignore[misc]
    with pytest.raises(SandboxInterruptedError, match="OSError"):  # made its own, it could be written to
        sandboxed(lambda: attacked(lambda _: os.link(foreign / "standing", own / "mine")), limits)
    assert [(path.name, path.read_bytes()) for path in foreign.iterdir()] == [("standing", b"stays")]


def test_a_file_in_its_folder_ends_where_the_limit_says(tmp_path: Path) -> None:
    with pytest.raises(SandboxCrashedError):
        sandboxed(
            lambda: bytes((tmp_path / "long").write_bytes(bytes(11)) > 0), SandboxLimits(folder=tmp_path, file_bytes=10)
        )
    assert (tmp_path / "long").stat().st_size <= 10


def test_connections_and_files_of_the_parent_are_not_the_childs() -> None:
    ours, theirs = socket.socketpair()
    number = ours.fileno()

    def speak() -> bytes:
        os.write(number, b"DROP TABLE users")
        return b""

    with ours, theirs:
        theirs.setblocking(False)
        with pytest.raises(SandboxInterruptedError, match="OSError"):  # the empty device, open for reading
            sandboxed(speak)
        with pytest.raises(BlockingIOError):
            theirs.recv(100)


def test_threads_and_arithmetic_go_on_inside_the_fences() -> None:
    import numpy as np

    def work() -> bytes:
        found: list[float] = []
        threads = [threading.Thread(target=lambda: found.append(float(np.eye(300).sum()))) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        return repr((found, np.linalg.inv(np.eye(50)).shape)).encode()

    assert sandboxed(work, SandboxLimits(memory_bytes=2**30)) == repr(([300.0] * 4, (50, 50))).encode()


def test_what_is_mapped_is_no_memory_but_what_is_allocated_is(tmp_path: Path) -> None:
    import numpy as np

    sparse = tmp_path / "sparse"
    with sparse.open("wb") as file:
        file.truncate(2**30)
    limits = SandboxLimits(memory_bytes=64 * 2**20, mapped_bytes=2**30, reads=(sparse,))
    assert sandboxed(lambda: str(np.memmap(sparse, mode="r").shape[0]).encode(), limits) == b"1073741824"
    with pytest.raises(SandboxCrashedError, match="64 MiB"):
        sandboxed(lambda: bytes(512 * 2**20), limits)


def test_a_missing_fence_is_warned_of_once_and_whole_fences_are_not_spoken_of(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parent, "_NOTED", set())
    with structlog.testing.capture_logs() as lines:
        sandboxed(lambda: b"")
    assert [line["log_level"] for line in lines if "none" not in line.values()] == []
    monkeypatch.setattr(seccomp, "MACHINES", ())
    monkeypatch.setattr("services.runtime.sandbox.fences._leave_the_network", lambda: False)
    with structlog.testing.capture_logs() as lines:
        sandboxed(lambda: b"")
        sandboxed(lambda: b"")
    assert [(line["log_level"], line["network"], line["processes"]) for line in lines] == [("warning", "none", "none")]


@pytest.mark.parametrize(
    ("landlock", "machines", "missing"),
    [
        (6, MACHINES, []),
        (5, MACHINES, ["landlock_without_signals"]),
        (0, MACHINES, ["no_landlock"]),
        (0, (), ["no_seccomp", "no_landlock"]),
    ],
)
@needs_seccomp
def test_a_service_names_the_fences_that_its_kernel_does_not_have(
    landlock: int, machines: tuple[str, ...], missing: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fork_client, "_SERVERS", [])
    monkeypatch.setattr(fences, "version", lambda: landlock)
    monkeypatch.setattr(seccomp, "MACHINES", machines)
    with structlog.testing.capture_logs() as lines:
        use_fork_server(())
        use_fork_server(())
    assert [(line["log_level"], line["fence"]) for line in lines] == [("warning", name) for name in missing]


def test_without_seccomp_the_network_is_left_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(seccomp, "MACHINES", ())
    with structlog.testing.capture_logs() as lines:
        monkeypatch.setattr(parent, "_NOTED", set())
        sandboxed(lambda: b"")
    if lines and lines[0]["network"] == "none":
        pytest.skip("nobody may make a namespace here")
    interfaces = sandboxed(lambda: b" ".join(line.split(b":")[0] for line in _network_lines()))
    assert interfaces.split() == [b"lo"]
    with pytest.raises(SandboxInterruptedError, match="OSError"):  # 101: the network is unreachable
        sandboxed(lambda: attacked(send_away))


def _network_lines() -> list[bytes]:
    return Path("/proc/self/net/dev").read_bytes().splitlines()[2:]


@pytest.mark.parametrize("machine", MACHINES)
@pytest.mark.parametrize("kind", seccomp.KINDS)
def test_no_jump_of_the_filter_leaves_it(machine: str, kind: str) -> None:
    program = seccomp.program_of(machine, 1, kind)
    assert len(program) < 4096  # BPF_MAXINSNS
    for place, op in enumerate(program):
        assert len(op) == 8
        assert place + 1 + max(op[2], op[3]) <= len(program) - (op[0] != seccomp.RETURN)
