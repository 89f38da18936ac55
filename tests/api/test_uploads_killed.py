"""Uploads while the API is killed or is two processes: what it says it has, it has, and the whole is right.

`STONE_CRASH_ROUNDS` asks for more rounds, `STONE_CRASH_SEED` for others; a failure names its seed.

Catches alone bytes that were acknowledged and are gone after a `kill -9`, and what two real processes do to one upload.
"""

import hashlib
import os
import random
import socket
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest

from services.runtime.platform import Platform
from services.runtime.uploads import upload_file
from services.runtime.uploads.rows import find
from testing.api.process import ApiProcess, running_api
from testing.api.serving import Person
from testing.api.tus import checksum, created, offset_of, patch, sha256_of, shown
from tests.services.runtime.uploads.sending import kept

ROUNDS = int(os.environ.get("STONE_CRASH_ROUNDS", "4"))
SEED = int(os.environ.get("STONE_CRASH_SEED", "20261121"))
SLICE_BYTES = 1 << 16

pytestmark = pytest.mark.release


@dataclass(frozen=True)
class Victim:
    """One upload under one API that is going to be killed."""

    process: ApiProcess
    api: httpx.Client
    owner: Person
    where: str
    content: bytes
    platform: Platform

    def check_prefix(self) -> int:
        """The offset, after showing that it is no more than the true bytes that are kept."""
        offset = offset_of(self.api, self.owner, self.where)
        here = self.kept_bytes()
        assert offset <= len(here) <= len(self.content)
        assert here[:offset] == self.content[:offset]
        return offset

    def kept_bytes(self) -> bytes:
        """What lies in the folder, verified or not, or in the store."""
        upload_id = self.where.rpartition("/")[2]
        if self.platform.settings.uploads.backend == "folder":
            return upload_file(self.platform.settings, upload_id).read_bytes()
        return kept(self.platform, find(self.platform.database, upload_id, self.owner.user_id))

    def send_and_kill(self, offset: int, kill_at: int, with_checksum: bool) -> None:
        """Send the rest from `offset` and kill the API when `kill_at` bytes of the file have left the client."""
        rest = self.content[offset:]
        head = [
            f"PATCH {self.where} HTTP/1.1", "Host: localhost", "Tus-Resumable: 1.0.0",
            "Content-Type: application/offset+octet-stream", f"Authorization: Bearer {self.owner.secret}",
            f"Upload-Offset: {offset}", f"Content-Length: {len(rest)}",
            *([f"Upload-Checksum: {checksum(rest)}"] if with_checksum else []),
        ]  # fmt: skip
        with socket.create_connection(("127.0.0.1", self.process.port), timeout=300) as connection:
            connection.sendall(("\r\n".join(head) + "\r\n\r\n").encode())
            for start in range(offset, min(kill_at, len(self.content)), SLICE_BYTES):
                connection.sendall(self.content[start : start + SLICE_BYTES])
            if kill_at > len(self.content):  # somewhere in its last step
                time.sleep((kill_at - len(self.content)) / 1e8)
            self.process.kill()


@pytest.fixture
def process(placed: Platform, tmp_path: Path) -> Iterator[ApiProcess]:
    with running_api(placed.settings, tmp_path / "api.log") as running:
        yield running


def victim_of(process: ApiProcess, platform: Platform, owner: Person, api: httpx.Client, content: bytes) -> Victim:
    where = created(api, owner, len(content), sha256=sha256_of(content))
    return Victim(process, api, owner, where, content, platform)


def resume(victim: Victim) -> None:
    """As a client does: ask, send, and ask again while a connection that the killed API never saw is worked off."""
    deadline = time.monotonic() + 300
    while (offset := victim.check_prefix()) < len(victim.content):
        reply = patch(victim.api, victim.owner, victim.where, offset, victim.content[offset:])
        assert reply.status_code in (204, 409, 423), reply.text
        assert time.monotonic() < deadline, "the upload cannot be resumed"


def survive(process: ApiProcess, platform: Platform, owner: Person, seed: int) -> None:
    """One upload, whose API is killed once; the process is up again afterwards."""
    chance = random.Random(seed)
    content = chance.randbytes(chance.randrange(1, 12 << 20))
    with httpx.Client(base_url=process.url, timeout=300) as api:
        victim = victim_of(process, platform, owner, api, content)
        begin = chance.choice([0, chance.randrange(len(content))])
        patch(api, owner, victim.where, 0, content[:begin])
        kill_at = chance.randint(begin, len(content) + (1 << 20))
        with suppress(ConnectionError):
            victim.send_and_kill(begin, kill_at, with_checksum=chance.random() < 0.4)
        assert begin <= len(victim.kept_bytes()) <= len(content)
        process.start()
        resume(victim)
        state = shown(api, owner, victim.where)
    assert (state["state"], state["sha256"]) == ("complete", hashlib.sha256(content).hexdigest())
    assert victim.kept_bytes() == content


def test_an_upload_survives_the_api_killed_at_any_moment(
    process: ApiProcess, placed: Platform, curator: Person
) -> None:
    for seed in range(SEED, SEED + ROUNDS):
        try:
            survive(process, placed, curator, seed)
        except AssertionError as failure:
            raise AssertionError(f"STONE_CRASH_SEED={seed} STONE_CRASH_ROUNDS=1: {failure}") from failure


def test_a_stopped_api_lets_the_lock_go_and_keeps_what_came(
    process: ApiProcess, placed: Platform, curator: Person
) -> None:
    content = random.Random(3).randbytes(6 << 20)
    with httpx.Client(base_url=process.url, timeout=300) as api:
        victim = victim_of(process, placed, curator, api, content)
        head = f"PATCH {victim.where} HTTP/1.1\r\nHost: localhost\r\nTus-Resumable: 1.0.0\r\nUpload-Offset: 0\r\n"
        head += f"Content-Type: application/offset+octet-stream\r\nAuthorization: Bearer {curator.secret}\r\n"
        with socket.create_connection(("127.0.0.1", process.port), timeout=300) as connection:
            connection.sendall(f"{head}Content-Length: {len(content)}\r\n\r\n".encode() + content[: 3 << 20])
            deadline = time.monotonic() + 300
            while victim.check_prefix() < 1 << 20:
                assert time.monotonic() < deadline, "nothing is written"
                time.sleep(0.01)
            process.stop()  # the client still holds its connection and would send more
        process.start()
        offset = victim.check_prefix()
        assert offset >= 1 << 20
        assert patch(api, curator, victim.where, offset, content[offset:]).status_code == 204
        assert shown(api, curator, victim.where)["sha256"] == sha256_of(content)
