"""A child whose n-th system call on a folder's files fails, or kills it: `disturb(work, folder, nth, fault)`.

**Conventions.** Only calls that change files are counted, in the order of arrival: writes, flushes, creations, renames,
links, deletions, lengths and stamps. They come from every thread and library of the child, SQLite included. The kernel
notifies this process before each call (seccomp(2), SECCOMP_RET_USER_NOTIF, Linux ≥ 5.5), so nothing is patched. `FULL`
counts only calls that need room, and every later one fails too, as on a full disk. `BROKEN` fails one call; `KILLED` is
kill −9 before the call. Two faults stay undetected: writes to mapped pages, and unflushed data lost in a power cut.
"""

import ctypes
import errno
import fcntl
import os
import platform
import select
import signal
import socket
import struct
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

NUMBERS = {
    "x86_64": {
        "write": 1, "pwrite64": 18, "writev": 20, "pwritev": 296, "pwritev2": 328, "sendfile": 40,
        "copy_file_range": 326, "fallocate": 285, "ftruncate": 77, "fsync": 74, "fdatasync": 75, "open": 2, "creat": 85,
        "openat": 257, "rename": 82, "renameat": 264, "renameat2": 316, "link": 86, "linkat": 265, "symlink": 88,
        "symlinkat": 266, "mkdir": 83, "mkdirat": 258, "unlink": 87, "unlinkat": 263, "rmdir": 84, "utimensat": 280,
    },
    "aarch64": {
        "write": 64, "pwrite64": 68, "writev": 66, "pwritev": 70, "pwritev2": 287, "sendfile": 71,
        "copy_file_range": 285, "fallocate": 47, "ftruncate": 46, "fsync": 82, "fdatasync": 83, "openat": 56,
        "renameat": 38, "renameat2": 276, "linkat": 37, "symlinkat": 36, "mkdirat": 34, "unlinkat": 35, "utimensat": 88,
    },
}  # fmt: skip
OF_DESCRIPTOR = {  # by the argument that is the file
    "write": 0, "pwrite64": 0, "writev": 0, "pwritev": 0, "pwritev2": 0, "sendfile": 0, "copy_file_range": 2,
    "fallocate": 0, "ftruncate": 0, "fsync": 0, "fdatasync": 0,
}  # fmt: skip
OF_PATH = {  # by the arguments that are the folder, if any, and the path
    "open": (None, 0), "creat": (None, 0), "openat": (0, 1), "rename": (None, 1), "renameat": (2, 3),
    "renameat2": (2, 3), "link": (None, 1), "linkat": (2, 3), "symlink": (None, 1), "symlinkat": (1, 2),
    "mkdir": (None, 0), "mkdirat": (0, 1), "unlink": (None, 0), "unlinkat": (0, 1), "rmdir": (None, 0),
    "utimensat": (0, 1),
}  # fmt: skip
FLAGS = {"open": 1, "openat": 2}
NEED_NO_ROOM = ("unlink", "unlinkat", "rmdir", "utimensat")


def _step(code: int, value: int, if_true: int = 0, if_false: int = 0) -> bytes:
    """Return an instruction of the filter (classic BPF)."""
    return struct.pack("HBBI", code, if_true, if_false, value)


LOAD, EQUAL, ANY_BIT = 0x20, 0x15, 0x45
ASK, ALLOW = _step(0x06, 0x7FC00000), _step(0x06, 0x7FFF0000)
PR_SET_NO_NEW_PRIVS, SET_MODE_FILTER, NEW_LISTENER = 38, 1, 8
RECEIVE, SEND, CONTINUE = 0xC0502100, 0xC0182101, 1
NOTICE, REPLY = struct.Struct("=QIIiIQ6Q"), struct.Struct("=QqiI")  # id, pid, flags, number, machine, place, arguments
LONGEST_PATH = 4096
DATABASE = ".sqlite3"
"""Only the first of consecutive equal calls on a SQLite file is disturbed: half of these calls concern only SQLite."""


class Fault(Enum):
    """The fate of the n-th call."""

    FULL = errno.ENOSPC
    BROKEN = errno.EIO
    KILLED = 0


@dataclass(frozen=True)
class Disturbed:
    """`hit` is the call that was disturbed, empty if the work ended before it; `raised` is the work's traceback."""

    hit: str
    was_killed: bool
    raised: str


def disturb(work: Callable[[], object], folder: Path, nth: int, fault: Fault) -> Disturbed:
    """Do the work in a forked child, whose `nth` call (from 1) on files below `folder` is disturbed."""
    ours, theirs = socket.socketpair()
    with ours, theirs:
        if (child := os.fork()) == 0:
            _work(work, theirs)
        theirs.close()  # a child that cannot listen ends, and the next line raises
        listener = socket.recv_fds(ours, 1, 1)[1][0]
        try:
            hit = _Supervisor(child, listener, os.path.realpath(folder), nth, fault).serve(ours)
        finally:
            os.close(listener)
            with suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
        output = b"".join(iter(lambda: ours.recv(2**16), b""))
        return Disturbed(hit, not output, output.removeprefix(b".").decode("utf-8", "replace"))


def apart(work: Callable[[], object]) -> str:
    """Do the work in a forked child, undisturbed, and return its traceback, if any.

    So this process keeps no threads, which a child that is forked later would lack.
    """
    ours, theirs = socket.socketpair()
    with ours, theirs:
        if (child := os.fork()) == 0:
            _say(work, theirs)
        theirs.close()
        output = b"".join(iter(lambda: ours.recv(2**16), b""))
        os.waitpid(child, 0)
        return output.removeprefix(b".").decode("utf-8", "replace") if output else "it ended without a word"


def _work(work: Callable[[], object], parent: socket.socket) -> None:
    """Install the filter, then run `_say`."""
    try:
        socket.send_fds(parent, [b"l"], [_listen()])
    except BaseException:
        os._exit(1)
    _say(work, parent)


def _say(work: Callable[[], object], parent: socket.socket) -> None:
    """Do the work, then send a point and the traceback, if any; the child does nothing else."""
    try:
        try:
            work()
            parent.sendall(b".")
        except BaseException:
            parent.sendall(b"." + traceback.format_exc().encode()[-8000:])
    finally:
        os._exit(0)


def _listen() -> int:
    """Install the filter and return the descriptor of the kernel's notifications."""
    steps = [_step(LOAD, 0)]  # the call's number
    for name, number in NUMBERS[platform.machine()].items():
        if name in FLAGS:  # other tests cover failing reads
            block = [_step(LOAD, 16 + 8 * FLAGS[name]), _step(ANY_BIT, os.O_CREAT, 0, 1), ASK, ALLOW]
        else:
            block = [ASK]
        steps += [_step(EQUAL, number, 0, len(block)), *block]
    steps.append(ALLOW)
    code = ctypes.create_string_buffer(b"".join(steps))
    program = ctypes.create_string_buffer(struct.pack("HxxxxxxQ", len(steps), ctypes.addressof(code)))
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)
    call = {"x86_64": 317, "aarch64": 277}[platform.machine()]
    listener = int(libc.syscall(call, SET_MODE_FILTER, NEW_LISTENER, program))
    if listener < 0:
        raise OSError(ctypes.get_errno(), "this kernel does not ask about system calls (seccomp(2))")
    return listener


class _Supervisor:
    """Answers the kernel until the child has reported the end of its work, or was killed."""

    def __init__(self, child: int, listener: int, folder: str, nth: int, fault: Fault) -> None:
        self._child, self._listener, self._folder, self._fault = child, listener, folder, fault
        self._left, self._hit, self._before = nth, "", ("", "")
        self._names = {number: name for name, number in NUMBERS[platform.machine()].items()}

    def serve(self, end: socket.socket) -> str:
        """Return the call that was disturbed."""
        waiting = select.poll()
        waiting.register(self._listener, select.POLLIN)
        waiting.register(end, select.POLLIN)
        while end.fileno() not in (ready := dict(waiting.poll())):
            if ready.get(self._listener, 0) & select.POLLIN:
                self._answer()
        return self._hit

    def _answer(self) -> None:
        notice = bytearray(NOTICE.size)
        try:
            fcntl.ioctl(self._listener, RECEIVE, notice)
        except OSError as error:  # the calling thread is dead
            if error.errno not in (errno.ENOENT, errno.EINTR):
                raise
            return
        notice_id, thread, _, number, _, _, *arguments = NOTICE.unpack(notice)
        refusal = self._refusal(self._names[number], thread, arguments)
        reply = REPLY.pack(notice_id, 0, -refusal, 0 if refusal else CONTINUE)
        with suppress(FileNotFoundError):
            fcntl.ioctl(self._listener, SEND, reply)

    def _refusal(self, name: str, thread: int, arguments: list[int]) -> int:
        """Return the error number for the call, or 0 if the call proceeds."""
        path = self._path(name, thread, arguments)
        if not path.startswith(self._folder):
            return 0
        is_full = self._fault is Fault.FULL
        if is_full and name in NEED_NO_ROOM:
            return 0
        before, self._before = self._before, (name, path)
        if before != self._before or DATABASE not in path:
            self._left -= 1
        if self._left > 0 or (not is_full and (self._left < 0 or self._hit)):
            return 0
        self._hit = self._hit or f"{name} {path.removeprefix(self._folder)}"
        if self._fault is Fault.KILLED:
            os.kill(self._child, signal.SIGKILL)
        return self._fault.value or errno.EINTR

    def _path(self, name: str, thread: int, arguments: list[int]) -> str:
        """Return the path of the call's file, or an empty string if the file has no name."""
        with suppress(OSError):
            if name in OF_DESCRIPTOR:
                return os.readlink(f"/proc/{thread}/fd/{arguments[OF_DESCRIPTOR[name]]}")
            at, index = OF_PATH[name]
            path = _text(thread, arguments[index])
            folder = ctypes.c_int(-1 if at is None else arguments[at] & 0xFFFFFFFF).value
            if os.path.isabs(path):
                return os.path.realpath(os.path.dirname(path)) + "/" + os.path.basename(path)
            return os.path.join(os.readlink(f"/proc/{thread}/{f'fd/{folder}' if folder >= 0 else 'cwd'}"), path)
        return ""


def _text(thread: int, address: int) -> str:
    """Return the string at an address of the thread's memory."""
    if not address:  # utimensat of an open file
        return ""
    with open(f"/proc/{thread}/mem", "rb", buffering=0) as memory:
        memory.seek(address)
        return os.fsdecode(memory.read(LONGEST_PATH).split(b"\0", 1)[0])
