"""Ranges of an object, served to a sandboxed child, which has no network.

    child: `PipedRanges.read_at` → ranges.asked → thread of the parent, which fetches → ranges.answered → child

**Conventions.** The named pipes are in the child's folder; the parent creates them and holds them open. A request is an
offset and a count, 16 bytes; an answer is its size, then the bytes. The parent treats a request as two untrusted
numbers, and reads at most `MOST_BYTES` for it.
"""

import fcntl
import os
import select
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from threading import Thread

from stone.errors import Refused
from stone_recordings.sync.stored_recording import RecordingPlace

ASKED, ANSWERED = "ranges.asked", "ranges.answered"
REQUEST, SIZE = struct.Struct("<2Q"), struct.Struct("<q")
MOST_BYTES = 16 * 2**20
FAILED = -1
ReadAt = Callable[[int, int], bytes]


@dataclass(frozen=True)
class PipedRanges:
    """The child's side: `ByteRanges` (`stone_files/byte_ranges.py`) through the pipes in the folder. Picklable."""

    path: Path
    size_bytes: int
    version: str
    folder: Path

    def read_at(self, offset: int, count: int) -> bytes:
        """Return the bytes. Raises `ranges_unavailable`; the parent has the reason."""
        stop, chunks = min(offset + count, self.size_bytes), list[bytes]()
        with (self.folder / ASKED).open("wb", buffering=0) as requests, (self.folder / ANSWERED).open("rb") as answered:
            fcntl.flock(requests, fcntl.LOCK_EX)
            for at in range(offset, stop, MOST_BYTES):
                requests.write(REQUEST.pack(at, min(MOST_BYTES, stop - at)))
                (size,) = SIZE.unpack(answered.read(SIZE.size))
                if size == FAILED:
                    raise Refused("ranges_unavailable", f"{self.path} could not be read from byte {at} on")
                chunks.append(answered.read(size))
        return b"".join(chunks)

    def identity(self) -> list[str | int]:
        return [str(self.path), self.version, self.size_bytes]


@contextmanager
def served_ranges(read_at: ReadAt, place: RecordingPlace, folder: Path) -> Iterator[PipedRanges]:
    """Yield ranges of the place's single file, for a child that may write to the folder.

    Raises what `read_at` raised, instead of the block's error.
    """
    (file,), where = place.files, folder.resolve()
    for name in (ASKED, ANSWERED):
        os.mkfifo(where / name, 0o600)
    requests, answered = (os.open(where / name, os.O_RDWR | os.O_NONBLOCK) for name in (ASKED, ANSWERED))
    ending, ended = os.pipe()
    server = _RangeServer(read_at, file.size_bytes, requests, answered, ending)
    thread = Thread(target=server.serve, name="ranges", daemon=True)
    thread.start()
    try:
        yield PipedRanges(Path(place.name), file.size_bytes, file.version, where)
    except Exception:
        if server.failed:
            raise server.failed[0] from None
        raise
    finally:
        os.close(ended)
        thread.join()
        for number in (requests, answered, ending):
            os.close(number)
        for name in (ASKED, ANSWERED):
            (where / name).unlink(missing_ok=True)
    if server.failed:
        raise server.failed[0]


@dataclass(frozen=True)
class _RangeServer:
    """The parent's side: answers until the pipe `ending` is closed or a range cannot be read."""

    read_at: ReadAt
    size_bytes: int
    requests: int
    answered: int
    ending: int
    failed: list[Exception] = field(default_factory=list)

    def serve(self) -> None:
        request = b""
        while self._is_ready(self.requests, select.POLLIN):
            request += os.read(self.requests, REQUEST.size - len(request))
            if len(request) == REQUEST.size:
                self._answer(*REQUEST.unpack(request))
                request = b""

    def _answer(self, offset: int, count: int) -> None:
        count = max(min(count, MOST_BYTES, self.size_bytes - offset), 0)
        try:
            content = self.read_at(offset, count) if count else b""
        except Exception as error:  # the block's thread raises it
            self.failed.append(error)
            self._send(SIZE.pack(FAILED))
            return
        self._send(SIZE.pack(len(content)) + content)

    def _send(self, content: bytes) -> None:
        left = memoryview(content)
        while left and self._is_ready(self.answered, select.POLLOUT):
            left = left[os.write(self.answered, left) :]

    def _is_ready(self, number: int, event: int) -> bool:
        """Wait for the pipe; return False if the block has ended meanwhile."""
        poll = select.poll()
        poll.register(number, event)
        poll.register(self.ending, 0)  # poll reports a closed pipe in any case
        return all(ready != self.ending for ready, _ in poll.poll())
