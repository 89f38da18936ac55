"""The fork server: sandboxed children of a service come from this process, which has no secret, connection or data.

**Conventions.** Its arguments are a descriptor for requests, and names to load first: modules, or functions to call
(`module:function`). A service has the keys of the database and of the store; every child forked from it would contain a
copy. So it uses this process, executed afresh with harmless environment variables (`fork_client.py`). Libraries and
compiled kernels are loaded first, so all children share them.

A request is a message with three descriptors: for reports on the child (`CHILD_*` below), for the child's answers, and
a file or pipe with its limits and its works. The service pickles the works. The child answers each work and ends after
the last. Closing the first descriptor ends the child; this process ends when no client is left.
"""

import services.runtime.one_thread
import services.runtime.processes.seldom_collected  # noqa: F401

# isort: split

import os
import pickle
import selectors
import signal
import socket
import struct
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from typing import BinaryIO

from services.runtime.sandbox.child import ProgressCallback, SandboxTask, run_child
from services.runtime.sandbox.system_files import system_files

REQUEST, CHILD_FORKED, CHILD_ENDED = b"r", b"f", b"e"
FORKED = struct.Struct("<ci")  # CHILD_FORKED, its pid
FATE = struct.Struct("<ciddq")  # CHILD_ENDED, wait status, user and system seconds, most memory in bytes
LENGTH = struct.Struct("<Q")
DESCRIPTORS = 3
Work = Callable[[ProgressCallback], bytes]


@dataclass(frozen=True)
class _Child:
    """A forked process: its pid, the descriptor that signals its end, and the socket of its client."""

    pid: int
    ended: int
    asker: socket.socket

    def end(self) -> None:
        signal.pidfd_send_signal(self.ended, signal.SIGKILL)

    def tell(self) -> None:
        """Reap the child and report its end to the client, if the client still exists."""
        _, status, used = os.wait4(self.pid, 0)
        os.close(self.ended)
        with suppress(OSError), self.asker:
            self.asker.send(FATE.pack(CHILD_ENDED, status, used.ru_utime, used.ru_stime, used.ru_maxrss * 1024))


def serve(requests: socket.socket) -> None:
    """Fork children for all clients until none is left."""
    with selectors.DefaultSelector() as selector:
        selector.register(requests, selectors.EVENT_READ)
        while True:
            for key, _ in selector.select():
                child, now = key.data, selector.get_map().get(key.fd)
                if now is None or now.data is not child:
                    continue
                if child is None:
                    if not _answer_request(requests, selector):
                        return
                elif key.fd == child.ended:
                    selector.unregister(child.ended)
                    _forget(selector, child)
                    child.tell()
                else:
                    _forget(selector, child)
                    child.end()


def _answer_request(requests: socket.socket, selector: selectors.BaseSelector) -> bool:
    """Fork once; return False if no client is left."""
    message, descriptors, _, _ = socket.recv_fds(requests, 1, DESCRIPTORS)
    if not message:
        return False
    asker, writing, task = socket.socket(fileno=descriptors[0]), descriptors[1], descriptors[2]
    try:
        pid = os.fork()
    except OSError:
        asker.close()  # the client treats this as a fault of the machine, which it is
    else:
        if pid == 0:
            run_child(*_read_task(task, writing))
        asker.send(FORKED.pack(CHILD_FORKED, pid))
        child = _Child(pid, os.pidfd_open(pid), asker)
        selector.register(asker, selectors.EVENT_READ, child)
        selector.register(child.ended, selectors.EVENT_READ, child)
    finally:
        os.close(writing)
        os.close(task)
    return True


def _forget(selector: selectors.BaseSelector, child: _Child) -> None:
    """Stop listening to the child's client."""
    with suppress(KeyError):
        selector.unregister(child.asker)


def _read_task(task: int, writing: int) -> tuple[SandboxTask, int]:
    """Read the task in the child. The works themselves are unpickled within the fences."""
    tasks = os.fdopen(os.dup(task), "rb")
    limits = pickle.loads(next(_read_parcels(tasks)))
    return SandboxTask(map(_Unpickled, _read_parcels(tasks)), limits, writing, tasks.fileno()), os.getppid()


def _read_parcels(tasks: BinaryIO) -> Iterator[bytes]:
    """Yield length-prefixed bytes as they arrive, until no writer is left."""
    while head := tasks.read(LENGTH.size):
        yield tasks.read(*LENGTH.unpack(head))


def parcel(content: object) -> bytes:
    """Return a part for a request's third descriptor: first the limits, then each work.

    Raises the errors of pickling for work that is not a plain function.
    """
    pickled = pickle.dumps(content)
    return LENGTH.pack(len(pickled)) + pickled


@dataclass(frozen=True)
class _Unpickled:
    """Work that is unpickled when it runs, where its errors are reported."""

    pickled: bytes

    def __call__(self, progress: ProgressCallback) -> bytes:
        work: Work = pickle.loads(self.pickled)
        return work(progress)


def load_first(named: Sequence[str]) -> None:
    """Import the modules, and call their functions named as `module:function`."""
    for name in named:
        module, _, function = name.partition(":")
        loaded = import_module(module)
        if function:
            getattr(loaded, function)()


def main() -> None:
    """Serve, ignoring Ctrl-C and the end of a service: children work as long as a client waits for them."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    with socket.socket(fileno=int(sys.argv[1])) as requests:
        load_first(sys.argv[2:])
        system_files()  # cached here for all children
        serve(requests)
