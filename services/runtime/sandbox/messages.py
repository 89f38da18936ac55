"""The message protocol from a sandboxed child to its parent: kind, length and payload, each bounded.

**Conventions.** A message is one byte of kind, eight of length (little-endian), then the payload. All payloads but the
answer are JSON of at most 128 KiB. The author of the input may control the child, so the parent unpickles nothing from
it, and an invalid message ends it.
"""

import json
import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass

from services.runtime.sandbox.errors import SandboxCrashedError

TICK, ANSWER, REFUSAL, MEMORY, CRASH, MACHINE, FLOODED, FENCED = range(8)
HEAD = struct.Struct("<BQ")
LONGEST_JSON_BYTES = 128 * 2**10
LONGEST_TEXT, LONGEST_STAGE = 2000, 100
CHUNK_BYTES = 2**16


@dataclass(frozen=True)
class SandboxMessage:
    """A message: one of the kinds above, and its payload."""

    kind: int
    payload: bytes

    def tick(self) -> tuple[str, int, int]:
        """Return stage, done, total. Raises `SandboxCrashedError`."""
        match _json(self.payload):
            case [str(stage), int(done), int(total)]:
                return stage[:LONGEST_STAGE], done, total
        raise SandboxCrashedError("sent invalid progress")

    def texts(self) -> dict[str, str]:
        """Return texts by name; empty if the payload is something else."""
        content = _json(self.payload)
        return {str(name): str(text) for name, text in content.items()} if isinstance(content, dict) else {}


class SandboxMessageReader:
    """A reader of messages from a non-blocking pipe."""

    def __init__(self, reading: int, answer_bytes: int) -> None:
        self._reading, self._answer_bytes = reading, answer_bytes
        self._kept = bytearray()
        self.is_closed = False

    @property
    def is_quiet(self) -> bool:
        """Whether all bytes read so far were returned as messages."""
        return not self.is_closed and not self._kept

    def words(self) -> Iterator[SandboxMessage]:
        """Yield the messages received so far, in order. Raises `SandboxCrashedError` for an invalid message."""
        while not self.is_closed:
            try:
                chunk = os.read(self._reading, CHUNK_BYTES)
            except BlockingIOError:
                return
            self.is_closed = not chunk
            self._kept += chunk
            yield from self._whole()

    def _whole(self) -> Iterator[SandboxMessage]:
        while len(self._kept) >= HEAD.size:
            kind, length = HEAD.unpack_from(self._kept)
            if kind > FENCED or length > (self._answer_bytes if kind == ANSWER else LONGEST_JSON_BYTES):
                raise SandboxCrashedError(f"sent an invalid message (kind {kind}, {length} bytes)")
            stop = HEAD.size + length
            if len(self._kept) < stop:
                return
            word = SandboxMessage(kind, bytes(self._kept[HEAD.size : stop]))
            del self._kept[:stop]
            yield word


def send_message(writing: int, kind: int, payload: bytes) -> None:
    """Send the whole message, waiting for the reader if necessary."""
    rest = memoryview(HEAD.pack(kind, len(payload)) + payload)
    while rest:
        rest = rest[os.write(writing, rest) :]


def texts_of(**texts: str) -> bytes:
    """Return texts as the payload of a message, each cut to `LONGEST_TEXT`."""
    return json.dumps({name: text[:LONGEST_TEXT] for name, text in texts.items()}).encode()


def tick_of(stage: str, done: int, total: int) -> bytes:
    """Return progress as the payload of a message."""
    return json.dumps([stage[:LONGEST_STAGE], done, total]).encode()


def _json(payload: bytes) -> object:
    try:
        content: object = json.loads(payload)
    except (ValueError, RecursionError):
        return None
    return content
