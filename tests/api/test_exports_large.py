"""A large archive passes through the server with flat memory, however many download it at once.

Catches alone an archive that is held in memory while it is sent.
"""

from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from hashlib import sha256
from pathlib import Path

import httpx
import pytest

from services.runtime.platform import Platform
from testing.api.process import running_api
from testing.api.serving import Person, client_of
from testing.worlds import made

pytestmark = pytest.mark.whole

MIB = 2**20
LARGE = 96 * MIB
MORE_BYTES = 40 * MIB


def test_memory_is_flat_while_archives_are_streamed(platform: Platform, curator: Person, tmp_path: Path) -> None:
    with client_of(platform) as client:
        sequence = made.sequence(client, curator)
    made.labels(platform, sequence)
    files = {"large.bin": bytes(LARGE), **{f"small/{n:04d}.bin": b"x" * 700 for n in range(20)}}
    made.export(platform, sequence["id"], files)
    path = f"/api/v1/sequences/{sequence['id']}/exports"
    with ExitStack() as stack:
        api = stack.enter_context(running_api(platform.settings, tmp_path / "api.log"))
        client = stack.enter_context(httpx.Client(base_url=api.url, headers=curator.headers, timeout=300))
        export = client.get(path).json()["items"][0]
        url = f"{path}/{export['id']}/archive?format=zip"
        client.get(url, headers={"Range": "bytes=-1000"})
        before = api.peak_bytes()
        with ThreadPoolExecutor(2) as pool:
            found = list(pool.map(lambda _: digest(client, url), range(2)))
        after = api.peak_bytes()
    wanted = {one["format"]: one["sha256"] for one in export["archives"]}["zip"]
    assert found == [wanted] * 2
    assert after - before < MORE_BYTES


def digest(client: httpx.Client, url: str) -> str:
    found = sha256()
    with client.stream("GET", url) as answer:
        for piece in answer.iter_bytes():
            found.update(piece)
    return found.hexdigest()
