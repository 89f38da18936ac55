"""A parser in the hands of whoever wrote the file reaches nothing: no network, no process, no file, no signal."""

import ctypes
import errno
import fcntl
import os
import resource
import signal
import socket
import struct
import subprocess
import termios
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
    "somebody who is signalled by a descriptor": lambda _: fcntl.fcntl(1, fcntl.F_SETOWN, os.getppid()),
    "another signal of a descriptor": lambda _: fcntl.fcntl(1, fcntl.F_SETSIG, signal.SIGKILL),
    "a descriptor that signals": lambda _: fcntl.fcntl(os.pipe()[0], fcntl.F_SETFL, os.O_ASYNC),
    "a lease": lambda _: fcntl.fcntl(os.open(os.__file__, os.O_RDONLY), fcntl.F_SETLEASE, fcntl.F_RDLCK),
    "a notice of a folder": lambda _: fcntl.fcntl(os.open(Path(os.__file__).parent, 0), fcntl.F_NOTIFY, 1),
    "words typed on the terminal": lambda _: fcntl.ioctl(1, termios.TIOCSTI, b"x"),
    "a file that is memory": lambda _: os.memfd_create("held"),
    "a process that may be looked at": lambda _: system_call("prctl", 4, 1, 0, 0, 0),
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


def verdict(machine: str, kind: str, number: int, *arguments: int, arch: int | None = None) -> str:
    """What the filter of the process 7 answers to a call: by an interpreter of our own of classic BPF (bpf(4))."""
    program = [struct.unpack("<HBBI", op) for op in seccomp.program_of(machine, 7, kind)]
    given = struct.pack("<iIQ6Q", number, arch or seccomp.AUDIT_ARCH[machine], 0, *(*arguments, *[0] * 6)[:6])
    held, place = 0, 0
    while True:
        code, if_true, if_false, value = program[place]
        place += 1
        if code == 0x06:
            named = {0x7FFF: "allowed", 0x8000: "killed", 0x0005: errno.errorcode.get(value & 0xFFFF, "")}
            return named[value >> 16]
        if code == 0x20:
            held = int.from_bytes(given[value : value + 4], "little")
        else:
            is_so = {0x15: held == value, 0x35: held >= value, 0x45: held & value != 0}[code]
            place += if_true if is_so else if_false


# By machine, from the kernel's headers; of the calls with which a child reaches out, and some that it needs.
CALLS = {
    "x86_64": {"openat": 257, "fcntl": 72, "kill": 62, "fchmodat": 268, "mkdirat": 258, "symlinkat": 266, "clone": 56,
               "clone3": 435, "prlimit64": 302, "futex": 202, "setpriority": 141, "sched_setaffinity": 203,
               "ioprio_set": 251, "bpf": 321, "execve": 59, "socket": 41, "truncate": 76},
    "aarch64": {"openat": 56, "fcntl": 25, "kill": 129, "fchmodat": 53, "mkdirat": 34, "symlinkat": 36, "clone": 220,
                "clone3": 435, "prlimit64": 261, "futex": 98, "setpriority": 140, "sched_setaffinity": 122,
                "ioprio_set": 30, "bpf": 280, "execve": 221, "socket": 198, "truncate": 45},
}  # fmt: skip
WRITE, CUT = os.O_WRONLY | os.O_CREAT | os.O_TRUNC, os.O_RDONLY | os.O_TRUNC
VERDICTS = [  # a call, its arguments, and what each kind of child is answered
    ("futex", (), "allowed allowed allowed"),
    ("openat", (0, 0, os.O_RDONLY), "allowed allowed allowed"),
    ("openat", (0, 0, WRITE), "EPERM allowed allowed"),
    ("openat", (0, 0, CUT), "EPERM EPERM EPERM"),
    ("mkdirat", (), "EPERM allowed allowed"),
    ("symlinkat", (), "EPERM EPERM allowed"),
    ("fcntl", (0, fcntl.F_SETFL, os.O_NONBLOCK), "allowed allowed allowed"),
    ("fcntl", (0, fcntl.F_SETFL, os.O_ASYNC), "EPERM EPERM EPERM"),
    ("fcntl", (0, fcntl.F_SETLK), "allowed allowed allowed"),
    ("fcntl", (0, 15), "EPERM EPERM EPERM"),  # F_SETOWN_EX
    ("kill", (7,), "allowed allowed allowed"),
    ("kill", (8,), "EPERM EPERM EPERM"),
    ("kill", (2**32 - 1,), "EPERM EPERM EPERM"),
    ("clone", (0x3D0F00,), "allowed allowed allowed"),  # as pthread_create(3) of glibc
    ("clone", (17,), "EPERM EPERM EPERM"),  # as fork(3)
    ("clone3", (), "ENOSYS ENOSYS ENOSYS"),
    ("prlimit64", (0, 7, 0), "allowed allowed allowed"),
    ("prlimit64", (0, 7, 2**32), "EPERM EPERM EPERM"),
    *((name, (), "EPERM EPERM EPERM") for name in
      ("fchmodat", "setpriority", "sched_setaffinity", "ioprio_set", "bpf", "execve", "socket", "truncate")),
]  # fmt: skip


@pytest.mark.parametrize("machine", MACHINES)
@pytest.mark.parametrize(("name", "arguments", "answers"), VERDICTS)
def test_the_filter_answers_on_every_machine(machine: str, name: str, arguments: tuple[int, ...], answers: str) -> None:
    found = [verdict(machine, kind, CALLS[machine][name], *arguments) for kind in seccomp.KINDS]
    assert found == answers.split()


@pytest.mark.parametrize("machine", MACHINES)
def test_what_is_newer_than_the_list_is_not_there_and_numbers_of_another_machine_end_the_child(machine: str) -> None:
    other = next(arch for name, arch in seccomp.AUDIT_ARCH.items() if name != machine)
    assert verdict(machine, "links", 469) == "EPERM"
    assert verdict(machine, "links", 470) == "ENOSYS"
    assert verdict(machine, "links", 0, arch=other) == "killed"
    if machine == "x86_64":
        assert verdict(machine, "links", 0x4000_0000 + 1) == "killed"
