"""Streams request bodies to disk: one block is written by a thread while the next is received.

**Conventions.** A request holds two blocks at most, regardless of client and disk speed. All work on disk and database
runs in threads of this module, so that a stalled disk stalls uploads only. One of these threads also writes the last
block, ends the upload and reads its offset, because each step takes as long as a statement. After `WAITING_S` the
received bytes are written, so that the bytes of a pausing client are on disk, not in memory.
"""

import asyncio
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass
from functools import partial
from typing import ParamSpec, TypeVar

from fastapi import Request
from starlette.requests import ClientDisconnect

from api.errors import ApiError
from services.runtime.database.transactions import UPLOADS
from services.runtime.orm import Upload
from services.runtime.platform import Platform
from services.runtime.uploads.completion import bytes_here
from services.runtime.uploads.files import MOST_PIECES
from services.runtime.uploads.reception import UploadChunk, UploadReceiver, receive
from services.runtime.uploads.rows import find

BLOCK_BYTES = 2 << 20
WAITING_S = 2.0
THREADS = ThreadPoolExecutor(UPLOADS, thread_name_prefix="upload")

P = ParamSpec("P")
T = TypeVar("T")


async def in_thread(function: Callable[P, T], *arguments: P.args, **options: P.kwargs) -> T:
    """Run the function in a thread of this module and return its result, with this request's log context."""
    in_context = copy_context().run
    work = partial(in_context, function, *arguments, **options)
    return await asyncio.get_running_loop().run_in_executor(THREADS, work)


@dataclass(frozen=True)
class ReceivedUpload:
    """An upload after a request, and the offset to show of it."""

    upload: Upload
    offset_bytes: int


async def receive_body(
    request: Request, platform: Platform, upload: tuple[str, str], piece: UploadChunk
) -> ReceivedUpload:
    """Write the request's body into the upload (id, owner's id), and return the upload."""
    reception = await in_thread(receive, platform, *upload, piece)
    if reception is None:
        return await in_thread(_received, platform, lambda: find(platform.database, *upload))
    try:
        last = await _pump(request, reception, platform.settings.uploads.idle_s)
        return await in_thread(_received, platform, lambda: reception.end(last))
    finally:
        reception.close()  # waits for a write under way: not even a cancelled request leaves a thread behind


def _received(platform: Platform, ended: Callable[[], Upload]) -> ReceivedUpload:
    upload = ended()
    return ReceivedUpload(upload, bytes_here(platform, upload))


async def _pump(request: Request, reception: UploadReceiver, idle_s: float) -> Sequence[bytes]:
    """Write all blocks except the last one, and return it."""
    blocks = _BlockWriter(reception)
    chunks = request.stream()
    try:
        while True:
            async with asyncio.timeout(idle_s):
                chunk = await anext(chunks, None)
            if chunk is None:
                return await blocks.rest()
            await blocks.take(chunk)
    except (ClientDisconnect, TimeoutError) as gone:
        await blocks.flush()
        await in_thread(reception.break_off)
        if isinstance(gone, TimeoutError):
            raise ApiError(
                "receive_timeout",
                f"no bytes arrived for {idle_s:g} s; read the offset with HEAD and resume from there",
                {"Connection": "close"},
            ) from gone
        raise
    finally:
        blocks.stop()


class _BlockWriter:
    """Collects chunks to blocks and writes them one after another, each in a thread."""

    def __init__(self, reception: UploadReceiver) -> None:
        self._reception = reception
        self._pieces: list[bytes] = []
        self._size_bytes = 0
        self._writing: asyncio.Future[None] | None = None
        self._due: asyncio.TimerHandle | None = None

    async def take(self, chunk: bytes) -> None:
        if not chunk:
            return
        self._pieces.append(chunk)
        self._size_bytes += len(chunk)
        self._due = self._due or asyncio.get_running_loop().call_later(WAITING_S, self._write_waiting)
        if self._size_bytes >= BLOCK_BYTES or len(self._pieces) >= MOST_PIECES:
            await self._write()

    async def rest(self) -> Sequence[bytes]:
        """Return the blocks taken and not written, after all others are written."""
        self.stop()
        await self._written()
        return self._pieces

    def stop(self) -> None:
        """Start no further write."""
        if self._due is not None:
            self._due.cancel()
            self._due = None

    async def flush(self) -> None:
        """Write all blocks taken."""
        if self._pieces:
            await self._write()
        await self._written()

    async def _write(self) -> None:
        self.stop()
        await self._written()
        self._begin()

    def _write_waiting(self) -> None:
        """Write the received bytes; during a write, later bytes are written after another `WAITING_S`."""
        self._due = None
        if self._writing is None or (self._writing.done() and not self._writing.exception()):
            self._begin()
        else:
            self._due = asyncio.get_running_loop().call_later(WAITING_S, self._write_waiting)

    def _begin(self) -> None:
        pieces, self._pieces, self._size_bytes = self._pieces, [], 0
        loop = asyncio.get_running_loop()
        self._writing = loop.run_in_executor(THREADS, self._reception.write, pieces)

    async def _written(self) -> None:
        writing, self._writing = self._writing, None
        if writing is not None:
            await writing
