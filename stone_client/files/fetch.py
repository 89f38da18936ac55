"""Downloads of single files: resumed after interruptions, verified by size and sha256.

**Conventions.** The ETag contains the sha256. A resumed download requests only the missing bytes (Range) of an
unchanged file (If-Range). If no new bytes arrive for `PATIENCE_S`, the download fails.
"""

from collections.abc import Callable, Iterator
from hashlib import sha256
from pathlib import Path

import httpx

from stone_client.api import BUSY, Api, Patience
from stone_client.errors import ServerRefusedError, ServerUnreachableError, damaged_download

PATIENCE_S = 60.0
PIECE_BYTES = 2**20
BEYOND_THE_END = 416
IDENTITY = {"Accept-Encoding": "identity"}
ByteListener = Callable[[int], None]


def ignore_bytes(_arrived_bytes: int) -> None:
    """Default listener for arrived bytes; does nothing."""


class PartialFile:
    """A partly downloaded file, with its size and hash.

    `promised` is the sha256 of the whole file if it is known in advance: then existing bytes are kept; otherwise the
    file starts empty.
    """

    def __init__(self, target: Path, promised: str = "") -> None:
        self.target, self.promised = target, promised
        self._found, self.size_bytes = sha256(), 0
        target.touch()
        for piece in _pieces(target) if promised else ():
            self._count(piece)
        self._keep_counted()

    def headers(self) -> dict[str, str]:
        """Request headers for the missing bytes."""
        if not self.size_bytes:
            return IDENTITY
        return {**IDENTITY, "Range": f"bytes={self.size_bytes}-", "If-Range": f'"{self.promised}"'}

    def begin(self, promised: str) -> None:
        """Prepare for a response with the whole file of this sha256."""
        self.promised, self._found, self.size_bytes = promised, sha256(), 0
        self._keep_counted()

    def add(self, pieces: Iterator[bytes], on_bytes: ByteListener) -> None:
        with self.target.open("ab") as file:
            for piece in pieces:
                file.write(piece)
                self._count(piece)
                on_bytes(self.size_bytes)

    @property
    def is_whole(self) -> bool:
        return bool(self.promised) and self._found.hexdigest() == self.promised

    def check(self, path: str) -> None:
        """Check the size and hash; on a mismatch delete the file, so that a retry can succeed. Raises
        `damaged_download`.
        """
        if not self.is_whole:
            sha256, promised = self._found.hexdigest(), self.promised
            self.begin("")
            raise damaged_download(path, sha256, promised)

    def _count(self, piece: bytes) -> None:
        self._found.update(piece)
        self.size_bytes += len(piece)

    def _keep_counted(self) -> None:
        with self.target.open("r+b") as file:
            file.truncate(self.size_bytes)


def save(api: Api, path: str, target: Path) -> None:
    """Download one file into `target`. Raises as `fetch` does."""
    fetch(api, path, PartialFile(target))


def fetch(api: Api, path: str, arriving: PartialFile, on_bytes: ByteListener = ignore_bytes) -> None:
    """Download the missing bytes of a file, with retries after broken connections and when the server is busy.

    Raises `damaged_download`, `ServerUnreachableError`, `ServerRefusedError`.
    """
    patience, before = Patience(PATIENCE_S), arriving.size_bytes
    while not arriving.is_whole:
        if arriving.size_bytes > before:
            patience, before = Patience(PATIENCE_S), arriving.size_bytes
        try:
            _fetch(api, path, arriving, on_bytes)
            return arriving.check(path)
        except httpx.TransportError as error:
            if not patience.wait(None):
                raise ServerUnreachableError(api.url, str(error) or type(error).__name__) from None
        except ServerRefusedError as error:
            if error.status == BEYOND_THE_END and arriving.size_bytes:
                arriving.begin(arriving.promised)
            elif error.status not in BUSY or not patience.wait(error.retry_after_s):
                raise


def _fetch(api: Api, path: str, arriving: PartialFile, on_bytes: ByteListener) -> None:
    with api.stream(path, arriving.headers()) as answer:
        if answer.status_code != 206:
            arriving.begin(answer.headers.get("ETag", "").strip('"'))
        arriving.add(answer.iter_bytes(), on_bytes)


def _pieces(path: Path) -> Iterator[bytes]:
    with path.open("rb") as file:
        while piece := file.read(PIECE_BYTES):
            yield piece
