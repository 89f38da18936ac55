"""Parallel uploads of the parts of a large file: one connection rarely uses the full bandwidth.

**Conventions.** As in `stone_client.files.tus`, the client stores nothing. A part is identified by its name, which
contains the sha256 of the whole, and its offset; the server then joins the complete parts (tus, concatenation).
"""

from collections.abc import Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import dataclass
from threading import Lock

from stone_client.api import Api, Patience
from stone_client.errors import ServerRefusedError, ServerUnreachableError
from stone_client.files.tus import (
    TUS,
    LocalContent,
    Purpose,
    Rest,
    begun,
    created,
    send_rest,
    upload_file,
    upload_like,
    upload_metadata,
)
from stone_client.progress import Report

PART = Purpose("part")
LEAST_PART_BYTES = 64 * 2**20
MOST_PARTS = 15
AT_ONCE = 4
JOINED_S = 900.0  # the server hashes a file of 500 GB within this time


@dataclass(frozen=True)
class PartOfFile:
    """A range of bytes as content of its own; only the server uses `name`."""

    whole: LocalContent
    start: int
    stop: int

    @property
    def name(self) -> str:
        return f"{self.whole.sha256}.{self.start}"

    @property
    def size_bytes(self) -> int:
        return self.stop - self.start

    @property
    def sha256(self) -> str:
        """Empty: a part declares no hash, as each piece and the whole file have their own."""
        return ""

    def read(self, offset: int, most_bytes: int) -> bytes:
        return self.whole.read(self.start + offset, min(most_bytes, self.size_bytes - offset))


def upload_in_parts(api: Api, local: LocalContent, purpose: Purpose, progress: Report) -> str:
    """Upload as `upload_file` does, over several connections if the file is large and the server can join parts."""
    parts = parts_of(local)
    if len(parts) < 2 or not _can_join(api):
        return upload_file(api, local, purpose, progress)
    if (standing := upload_like(api, local, purpose)) is not None:
        is_joined = standing["state"] == "open" and standing["detail"]
        return _wait_until_joined(api, standing["id"]) if is_joined else upload_file(api, local, purpose, progress)
    known = [begun(api, part, PART) for part in parts]
    if not any(known):
        upload_id, offset = created(api, local, purpose)
        if offset == local.size_bytes:
            return upload_id
        api.send("DELETE", f"/uploads/{upload_id}", headers=TUS)
    total = _Total(local.size_bytes, progress)
    with ThreadPoolExecutor(AT_ONCE) as pool:
        sent = [pool.submit(_send, api, part, upload, total) for part, upload in zip(parts, known, strict=True)]
        try:
            failed = [future for future in wait(sent, return_when=FIRST_EXCEPTION).done if future.exception()]
            ids = [future.result() for future in failed or sent]
        except BaseException:
            total.is_given_up = True
            pool.shutdown(cancel_futures=True)
            raise
    return _joined(api, local, purpose, ids)


def parts_of(local: LocalContent) -> list[PartOfFile]:
    """Return equal parts of at least `LEAST_PART_BYTES`; the last part may be shorter."""
    count = max(1, min(MOST_PARTS, local.size_bytes // LEAST_PART_BYTES))
    length = -(-local.size_bytes // count)
    return [PartOfFile(local, at, min(at + length, local.size_bytes)) for at in range(0, local.size_bytes, length or 1)]


class _GivenUpError(Exception):
    """Another part failed."""


class _Total:
    """The number of bytes sent of all parts."""

    def __init__(self, size_bytes: int, progress: Report) -> None:
        self._size_bytes, self._progress, self._lock = size_bytes, progress, Lock()
        self._done: dict[int, int] = {}
        self.is_given_up = False

    def of_part(self, start: int) -> Report:
        def said(stage: str, done: int, _total: int) -> None:
            if self.is_given_up:
                raise _GivenUpError
            with self._lock:
                self._done[start] = done
                self._progress(stage, sum(self._done.values()), self._size_bytes)

        return said


def _send(api: Api, part: PartOfFile, upload: tuple[str, int] | None, total: _Total) -> str:
    upload_id, offset = upload or created(api, part, PART, concat="partial")
    send_rest(api, f"/uploads/{upload_id}", Rest(part, offset), total.of_part(part.start))
    return upload_id


def _joined(api: Api, local: LocalContent, purpose: Purpose, part_ids: Sequence[str]) -> str:
    """Return the id of the upload after the server has joined its parts; a lost answer is requested again."""
    addresses = " ".join(f"/api/v1/uploads/{part_id}" for part_id in part_ids)
    headers = {**TUS, "Upload-Concat": f"final;{addresses}", "Upload-Metadata": upload_metadata(local, purpose)}
    try:
        upload_id = api.send("POST", "/uploads", headers=headers).headers["Location"].rpartition("/")[2]
    except (ServerRefusedError, ServerUnreachableError):
        upload = upload_like(api, local, purpose)
        if upload is None:
            raise
        upload_id = upload["id"]
    return _wait_until_joined(api, upload_id)


def _wait_until_joined(api: Api, upload_id: str) -> str:
    """Return the upload's id when it is no longer open, or when its offset has not grown for a long time (hashing
    included).
    """
    patience, before = Patience(JOINED_S), -1
    while (item := api.read(f"/uploads/{upload_id}"))["state"] == "open":
        if item["offset_bytes"] > before:
            patience, before = Patience(JOINED_S), item["offset_bytes"]
        if not patience.wait(None):
            break
    return upload_id


def _can_join(api: Api) -> bool:
    return "concatenation" in api.send("OPTIONS", "/uploads").headers.get("Tus-Extension", "").split(",")
