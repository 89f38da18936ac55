"""Two processes on one place and one database, and clients that leave: nothing is written twice or lost.

Catches alone what two real processes do to one upload.
"""

import os
import random
import socket
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx
import pytest

from services.runtime.platform import Platform
from services.runtime.uploads.rows import find
from testing.api.process import running_api
from testing.api.serving import Person, client_of
from testing.api.tus import created, offset_of, patch, sha256_of, shown
from tests.services.runtime.uploads.sending import kept

pytestmark = pytest.mark.whole


@pytest.fixture
def two(placed: Platform, tmp_path: Path) -> Iterator[tuple[httpx.Client, httpx.Client]]:
    """One client of a server in this process, one of another process."""
    with (
        client_of(placed) as here,
        running_api(placed.settings, tmp_path / "api.log") as process,
        httpx.Client(base_url=process.url, timeout=300) as there,
    ):
        yield here, there


def test_pieces_may_go_to_either(two: tuple[httpx.Client, httpx.Client], curator: Person) -> None:
    content = os.urandom(500_000)
    where = created(two[0], curator, len(content), sha256=sha256_of(content))
    for number, offset in enumerate(range(0, len(content), 100_000)):
        reply = patch(two[number % 2], curator, where, offset, content[offset : offset + 100_000])
        assert reply.status_code == 204, reply.text
    assert shown(two[0], curator, where)["state"] == "complete"


def test_clients_that_fight_over_an_upload_leave_it_right(
    two: tuple[httpx.Client, httpx.Client], placed: Platform, curator: Person
) -> None:
    for seed in range(3):
        let_fight(two, placed, curator, seed)


def let_fight(two: tuple[httpx.Client, httpx.Client], platform: Platform, curator: Person, seed: int) -> None:
    content = random.Random(seed).randbytes(300_000)
    where = created(two[0], curator, len(content), sha256=sha256_of(content))

    def fight(number: int) -> None:
        chance = random.Random(seed * 100 + number)
        with httpx.Client(base_url=two[number % 2].base_url, timeout=300) as api:
            deadline = time.monotonic() + 300
            while (offset := offset_of(api, curator, where)) < len(content):
                assert time.monotonic() < deadline, "nobody gets on"
                piece = content[offset : offset + chance.randrange(1, 80_000)]
                reply = patch(api, curator, where, offset, piece)
                assert reply.status_code in (204, 409, 423), reply.text

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(fight, range(4)))
    assert shown(two[0], curator, where)["sha256"] == sha256_of(content)
    upload = find(platform.database, where.rpartition("/")[2], curator.user_id)
    assert kept(platform, upload) == content


def test_a_client_that_leaves_keeps_what_arrived(placed: Platform, curator: Person) -> None:
    with client_of(placed) as api:
        kept_bytes = (leave_and_come_back(api, curator) for _ in range(20))
        assert next(filter(None, kept_bytes), 0) >= 1 << 20


def leave_and_come_back(api: httpx.Client, curator: Person) -> int:
    """What was kept of 2 MiB; 0 where the second request was served before the first, as on a busy machine."""
    content = os.urandom(3 << 20)
    where = created(api, curator, len(content), sha256=sha256_of(content))
    head = f"PATCH {where} HTTP/1.1\r\nHost: localhost\r\nTus-Resumable: 1.0.0\r\nUpload-Offset: 0\r\n"
    head += f"Content-Type: application/offset+octet-stream\r\nAuthorization: Bearer {curator.secret}\r\n"
    with socket.create_connection((api.base_url.host, api.base_url.port or 80), timeout=300) as connection:
        connection.sendall(f"{head}Content-Length: {len(content)}\r\n\r\n".encode() + content[: 2 << 20])
    deadline = time.monotonic() + 300
    while (reply := patch(api, curator, where, offset := offset_of(api, curator, where), content[offset:])).is_error:
        assert reply.status_code in (409, 423), reply.text
        assert time.monotonic() < deadline, "the lock of a client that left is never given back"
        time.sleep(0.01)
    assert shown(api, curator, where)["sha256"] == sha256_of(content)
    return offset
