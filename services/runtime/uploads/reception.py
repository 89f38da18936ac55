"""Receive the bytes of one request into an upload.

**Conventions.** Call `receive` first, `write` for each piece, then `end` (all bytes arrived) or `break_off` (the client
disconnected), and always `close`. These calls block on the disk or the database, never on the network: async callers
use threads, one call at a time. Bytes are added at the end, never beyond the declared length, so a killed process
leaves a prefix of the file. The backend decides where they lie and what a power cut may cost.
"""

import hashlib
import threading
from collections.abc import Sequence
from dataclasses import dataclass

from services.runtime.orm import Upload
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.uploads.backends import LockedUpload, backend_of
from services.runtime.uploads.completion import settle
from services.runtime.uploads.errors import DiskFullError, upload_gone
from services.runtime.uploads.files import ROLLING
from services.runtime.uploads.joining import part_ids_of
from services.runtime.uploads.rows import WHOLE, expiry_ns, find_alive, move, refuse_gone
from stone.errors import Refused

ALGORITHMS = ("sha1", "sha256")


@dataclass(frozen=True)
class Checksum:
    """The expected hash of one request's bytes; `algorithm` is one of `ALGORITHMS`."""

    algorithm: str
    digest: bytes


@dataclass(frozen=True)
class UploadChunk:
    """The declaration of one request's bytes; `length_bytes` is None if only their end determines it."""

    offset_bytes: int
    length_bytes: int | None = None
    checksum: Checksum | None = None


class UploadReceiver:
    """One request's lock on an upload, whose row was read under the lock.

    If a thread still works for a cancelled request, `close` waits for it: a closed descriptor might be given to another
    file while the thread uses it.
    """

    def __init__(self, platform: Platform, upload: Upload, held: LockedUpload, piece: UploadChunk) -> None:
        self.offset_bytes = self._first_byte = piece.offset_bytes
        self._platform, self._upload, self._hold = platform, upload, held
        self._guard = threading.Lock()
        self._rolling = ROLLING.take(upload.id, piece.offset_bytes)
        self._before = self._rolling.copy() if self._rolling and piece.checksum else None
        self._checksum = piece.checksum
        self._checking = hashlib.new(piece.checksum.algorithm) if piece.checksum else None
        if piece.checksum:
            held.mark_unverified()

    def write(self, pieces: Sequence[bytes]) -> None:
        """Append bytes. Raises `over_length` (and discard this request's bytes), `DiskFullError`."""
        with self._guard:
            self._write(pieces)

    def end(self, last: Sequence[bytes] = ()) -> Upload:
        """Append the last bytes of the request, check and flush them, and complete the upload if it is whole.

        Raises `checksum_mismatch` (and discard the bytes), `FileMismatchError`, and the errors of `write`.
        """
        with self._guard:  # take it once: between two locks the request could end and the file be closed
            if last:
                self._write(last)
            return self._end()

    def break_off(self) -> None:
        """End a request whose client disconnected: its bytes count unless it has a checksum. Raises as `accept`."""
        with self._guard:
            self._give_up_unverified()
            if self._checksum is None:
                self._hold.accept(is_whole=False)
                self._remember()

    def close(self) -> None:
        with self._guard:
            self._hold.close()

    def _write(self, pieces: Sequence[bytes]) -> None:
        reached = self.offset_bytes + sum(map(len, pieces))
        if reached > self._upload.length_bytes:
            self._cut()
            raise over_length(reached, self._upload.length_bytes)
        try:
            self._hold.append(pieces, self.offset_bytes)
        except OSError:
            self._rolling = None
            raise
        except DiskFullError as error:
            self._rolling = None
            self._give_up_unverified()
            raise DiskFullError(self._hold.kept_bytes, error.why) from None
        for piece in pieces:
            for state in (self._rolling, self._checking):
                if state is not None:
                    state.update(piece)
        self.offset_bytes = reached

    def _end(self) -> Upload:
        self._verify()
        is_whole = self.offset_bytes == self._upload.length_bytes
        self._hold.accept(is_whole=is_whole)
        if is_whole:
            return settle(self._platform, self._upload, self._hold, self._rolling.hexdigest() if self._rolling else "")
        self._remember()
        return self._extend()

    def _verify(self) -> None:
        if self._checksum is None or self._checking is None or self._checking.digest() == self._checksum.digest:
            return
        end = self.offset_bytes
        self._cut()
        raise Refused(
            "checksum_mismatch",
            f"the {self._checksum.algorithm} of bytes {self._first_byte}-{end} differs, and the server discarded "
            "them; send them again",
        )

    def _give_up_unverified(self) -> None:
        if self._checksum is not None:
            self._cut()

    def _cut(self) -> None:
        """Discard this request's bytes."""
        self._hold.discard()
        self.offset_bytes = self._first_byte
        if self._before is not None:
            ROLLING.keep(self._upload.id, self._first_byte, self._before)

    def _remember(self) -> None:
        if self._rolling is not None:
            ROLLING.keep(self._upload.id, self.offset_bytes, self._rolling)

    def _extend(self) -> Upload:
        """Return the upload; renew its full time if less than half is left."""
        half_ns = int(self._platform.settings.uploads.expires_s * 5e8)
        if self._upload.expires_ns - now_ns() < half_ns:
            self._upload.expires_ns = expiry_ns(self._platform)
            with self._platform.database.transaction() as session:
                move(session, self._upload, "open", expires_ns=self._upload.expires_ns)
        return self._upload


def receive(platform: Platform, upload_id: str, owner_id: str, piece: UploadChunk) -> UploadReceiver | None:
    """Prepare to receive a request's bytes; return None if the upload is whole already and the request adds none.

    Raises `upload_missing`, `upload_gone`, `UploadLockedError`, `offset_mismatch`, `over_length`, `DiskFullError`.
    """
    upload = find_alive(platform.database, upload_id, owner_id)
    if upload.state in WHOLE:
        _refuse_misplaced(upload, upload.length_bytes, piece)
        return None
    if part_ids_of(upload):
        raise Refused("joined_upload", f"upload {upload.id} is made from its parts; do not send bytes to it")
    held = _hold(platform, upload)
    try:
        upload = find_alive(platform.database, upload_id, owner_id)
        refuse_gone(upload)
        _refuse_misplaced(upload, held.kept_bytes, piece)
        if upload.state == "open":
            return UploadReceiver(platform, upload, held, piece)
    except BaseException:
        held.close()
        raise
    held.close()
    return None


def _hold(platform: Platform, upload: Upload) -> LockedUpload:
    try:
        return backend_of(platform, upload).hold(upload)
    except FileNotFoundError:  # it ended after the row was read, or a person deleted the file
        refuse_gone(find_alive(platform.database, upload.id, upload.owner_id))
        raise upload_gone(upload.id, "lost", "its file is not in the uploads folder") from None


def _refuse_misplaced(upload: Upload, offset_bytes: int, piece: UploadChunk) -> None:
    if piece.offset_bytes != offset_bytes:
        raise Refused(
            "offset_mismatch",
            f"the server has {offset_bytes} bytes, not {piece.offset_bytes}; resume from byte {offset_bytes}",
        )
    reached = piece.offset_bytes + (piece.length_bytes or 0)
    if reached > upload.length_bytes:
        raise over_length(reached, upload.length_bytes)


def over_length(reached_bytes: int, length_bytes: int) -> Refused:
    return Refused(
        "over_length", f"the upload was declared with {length_bytes} bytes, but would have at least {reached_bytes}"
    )
