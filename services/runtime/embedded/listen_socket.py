"""The API's listening socket, kept open by the supervisor across API restarts.

**Conventions.** While a dead API is restarted, connections wait in the backlog instead of being refused.
"""

import fcntl
import json
import os
import select
import signal
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

from services.runtime.embedded.errors import PortTakenError
from services.runtime.settings import ApiSettings
from stone.errors import Refused

BACKLOG = 1024
EVERYWHERE = {"0.0.0.0": "127.0.0.1", "::": "::1"}


def listen(api: ApiSettings) -> socket.socket:
    """Return a listening socket on the configured host and port (0: any). Raises `PortTakenError`."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            api.host, api.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
    except socket.gaierror as error:
        raise PortTakenError(api.host, api.port, str(error.strerror)) from None
    listener = socket.socket(family, kind, protocol)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind(address)
        listener.listen(BACKLOG)
    except OSError as error:
        listener.close()
        raise PortTakenError(api.host, api.port, os.strerror(error.errno or 0)) from None
    return listener


def reached_at(api: ApiSettings, listener: socket.socket) -> ApiSettings:
    """Return the API's settings with the actual port; an explicitly set URL is kept."""
    port = int(listener.getsockname()[1])
    if api.url != ApiSettings().url:
        return replace(api, port=port)
    return replace(api, port=port, url=local_url(api.host, port))


def local_host(host: str) -> str:
    """Return the name by which this machine reaches a server that listens on `host`."""
    return EVERYWHERE.get(host, host)


def local_url(host: str, port: int) -> str:
    """Return the URL by which this machine reaches a server that listens on `host`."""
    name = local_host(host)
    return f"http://[{name}]:{port}" if ":" in name else f"http://{name}:{port}"


def close(listener: socket.socket) -> None:
    """Stop accepting connections through this process's copy of the socket."""
    with suppress(OSError):
        listener.close()


# The lock file (flock) that admits one supervisor per data folder and identifies it. The kernel releases the lock with
# the process, so `kill -9` leaves no stale lock. Children do not inherit the descriptor.


LOCK = "server.lock"


class FolderLock:
    """The held lock of a data folder."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def say(self, url: str) -> None:
        """Write the holder's process id and URL, for a second server to quote."""
        record = json.dumps({"pid": os.getpid(), "url": url}).encode()
        os.ftruncate(self._descriptor, 0)
        os.pwrite(self._descriptor, record, 0)


@contextmanager
def hold_folder(folder: Path) -> Iterator[FolderLock]:
    """Hold `folder`, created for its owner only if missing. Raises `already_serving`."""
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    descriptor = os.open(folder / LOCK, os.O_CREAT | os.O_RDWR, 0o600)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise already_serving(folder, *_holder(descriptor)) from None
        lock = FolderLock(descriptor)
        lock.say("")
        yield lock
    finally:
        os.close(descriptor)


def stop_holder(folder: Path) -> tuple[int, str]:
    """Send SIGTERM to the supervisor that holds `folder`, wait until it has ended, and return its process id and URL.

    The signal goes to a descriptor of the process that held the lock when its id was read, so another process with the
    same id never receives it. Raises `not_serving`.
    """
    descriptor = _opened_lock(folder)
    try:
        pid, url = _holder(descriptor)
        if not url:
            raise not_serving(folder, "its server is still starting" if pid else "try again")
        process = os.pidfd_open(pid)
        try:
            if _is_free(descriptor) or _holder(descriptor) != (pid, url):
                raise not_serving(folder, "its server has just ended")
            signal.pidfd_send_signal(process, signal.SIGTERM)
            select.select([process], [], [])
        finally:
            os.close(process)
    except ProcessLookupError:
        raise not_serving(folder, "its server has just ended") from None
    finally:
        os.close(descriptor)
    return pid, url


def _opened_lock(folder: Path) -> int:
    """Return the descriptor of the lock file of a held folder. Raises `not_serving`."""
    try:
        descriptor = os.open(folder / LOCK, os.O_RDWR)
    except FileNotFoundError:
        raise not_serving(folder, "it is not the data folder of a server") from None
    if _is_free(descriptor):
        os.close(descriptor)
        raise not_serving(folder, "no process uses it")
    return descriptor


def _is_free(descriptor: int) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    fcntl.flock(descriptor, fcntl.LOCK_UN)
    return True


def not_serving(folder: Path, why: str) -> Refused:
    return Refused("not_serving", f"no server can be stopped in {folder}: {why}; give the server's folder with --data")


def _holder(descriptor: int) -> tuple[int, str]:
    try:
        record = json.loads(os.pread(descriptor, 4096, 0))
        return int(record["pid"]), str(record["url"])
    except (ValueError, KeyError, TypeError):  # the holder is writing it
        return 0, ""


def already_serving(folder: Path, pid: int, url: str) -> Refused:
    where = f"process {pid} serves it at {url}" if url else f"process {pid} is starting with it"
    return Refused(
        "already_serving", f"{folder} is in use: {where}; use that server, or choose another folder with --data"
    )
