"""Uploads of a large file in parts side by side: one connection seldom fills a long line.

**Conventions.** As `stone_client.files.tus`: nothing is kept on this side. A part is found again by its name, which has
the sha256 of the whole, and its place; parts that are complete are then joined by the server (tus, concatenation).
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
JOINED_S = 900.0  # a file of 500 GB is hashed meanwhile


@dataclass(frozen=True)
class PartOfFile:
    """Some bytes of a file, as content of its own; `name` is known by the server alone."""

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
        """None is declared: each piece has one, and so has the whole."""
        return ""

    def read(self, offset: int, most_bytes: int) -> bytes:
        return self.whole.read(self.start + offset, min(most_bytes, self.size_bytes - offset))


def upload_in_parts(api: Api, local: LocalContent, purpose: Purpose, progress: Report) -> str:
    """As `upload_file`, by several connections if the file is large and the server can join parts."""
    parts = parts_of(local)
    if len(parts) < 2 or not _can_join(api):
        return upload_file(api, local, purpose, progress)
    if (standing := upload_like(api, local, purpose)) is not None:
        is_joined = standing["state"] == "open" and standing["detail"]
        return _wait_until_joined(api, standing["id"]) if is_joined else upload_file(api, local, purpose, progress)
    known = [begun(api, part, PART) for part in parts]
    if not any(known):
        upload_id, offset = created(api, local, purpose)
        if offset == local.size_bytes:  # the server has these bytes already
            return upload_id
        api.send("DELETE", f"/uploads/{upload_id}", headers=TUS)
    total = _Total(local.size_bytes, progress)
    with ThreadPoolExecutor(AT_ONCE) as pool:
        sent = [pool.submit(_send, api, part, found, total) for part, found in zip(parts, known, strict=True)]
        try:
            failed = [one for one in wait(sent, return_when=FIRST_EXCEPTION).done if one.exception()]
            ids = [one.result() for one in failed or sent]
        except BaseException:
            total.is_given_up = True
            pool.shutdown(cancel_futures=True)
            raise
    return _joined(api, local, purpose, ids)


def parts_of(local: LocalContent) -> list[PartOfFile]:
    """Equal parts of at least `LEAST_PART_BYTES`, the last one perhaps shorter."""
    count = max(1, min(MOST_PARTS, local.size_bytes // LEAST_PART_BYTES))
    length = -(-local.size_bytes // count)
    return [PartOfFile(local, at, min(at + length, local.size_bytes)) for at in range(0, local.size_bytes, length or 1)]


class _GivenUpError(Exception):
    """Another part failed."""


class _Total:
    """How much of all parts was sent."""

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


def _send(api: Api, part: PartOfFile, found: tuple[str, int] | None, total: _Total) -> str:
    upload_id, offset = found or created(api, part, PART, concat="partial")
    send_rest(api, f"/uploads/{upload_id}", Rest(part, offset), total.of_part(part.start))
    return upload_id


def _joined(api: Api, local: LocalContent, purpose: Purpose, part_ids: Sequence[str]) -> str:
    """The whole upload, once the server has joined it; an answer that is lost is asked for again."""
    addresses = " ".join(f"/api/v1/uploads/{part_id}" for part_id in part_ids)
    headers = {**TUS, "Upload-Concat": f"final;{addresses}", "Upload-Metadata": upload_metadata(local, purpose)}
    try:
        upload_id = api.send("POST", "/uploads", headers=headers).headers["Location"].rpartition("/")[2]
    except (ServerRefusedError, ServerUnreachableError):
        found = upload_like(api, local, purpose)
        if found is None:
            raise
        upload_id = found["id"]
    return _wait_until_joined(api, upload_id)


def _wait_until_joined(api: Api, upload_id: str) -> str:
    """Its id, when it is not open any more, or its offset has not grown for long: hashing is waited for, too."""
    patience, before = Patience(JOINED_S), -1
    while (item := api.read(f"/uploads/{upload_id}"))["state"] == "open":
        if item["offset_bytes"] > before:
            patience, before = Patience(JOINED_S), item["offset_bytes"]
        if not patience.wait(None):
            break
    return upload_id


def _can_join(api: Api) -> bool:
    return "concatenation" in api.send("OPTIONS", "/uploads").headers.get("Tus-Extension", "").split(",")
