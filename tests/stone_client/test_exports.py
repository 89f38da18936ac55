"""Exports by the commands: listed, downloaded, taken up where a broken connection left them; never half a file."""

import fcntl
import json
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import Any

import httpx
import pytest

from services.runtime.platform import Platform
from stone_client.api import Api
from stone_client.credentials import Server
from stone_client.errors import ServerUnreachableError
from stone_client.files import fetch as fetching
from stone_client.files.fetch import PartialFile, fetch, save
from testing.api.serving import Person, client_of
from testing.refusals import refused_as
from testing.worlds import made
from tests.stone_client.participating import refused, stone

CONTENT = bytes(range(256)) * 4000
NAME = "samples/LIDAR_TOP/points.bin"


@pytest.fixture
def forest(platform: Platform, owner: Person) -> dict[str, Any]:
    with client_of(platform) as api:
        sequence = made.sequence(api, owner, "forest")
    made.labels(platform, sequence)
    return sequence


pytestmark = pytest.mark.usefixtures("as_owner")


@pytest.mark.parametrize("kind", ["tar", "zip"])
def test_an_export_is_listed_and_downloaded(
    platform: Platform, forest: dict[str, Any], tmp_path: Path, kind: str
) -> None:
    made.export(platform, forest["id"], {NAME: CONTENT})
    listed = stone("sequence", "exports", "forest", "--json")
    assert [one["state"] for one in json.loads(listed.stdout)["exports"]] == ["succeeded"]
    assert "mesh" in stone("sequence", "exports", "forest").stdout
    again = stone("sequence", "exports", "forest", "--format", "mesh", "--json")
    assert json.loads(again.stdout) == json.loads(listed.stdout), "what stands is not made again"
    output = tmp_path / f"forest.{kind}"
    outcome = stone("sequence", "download", "forest", "--format", "mesh", "-o", output, "--json")
    assert outcome.exit_code == 0, outcome.stderr
    record = json.loads(outcome.stdout)
    assert sha256(output.read_bytes()).hexdigest() == record["sha256"]
    assert {path.name for path in tmp_path.iterdir()} <= {output.name, "configuration", "data"}


def test_a_download_that_was_killed_goes_on_where_it_was(
    platform: Platform, forest: dict[str, Any], tmp_path: Path
) -> None:
    made.export(platform, forest["id"], {NAME: CONTENT})
    output = tmp_path / "forest.tar"
    whole = json.loads(stone("sequence", "download", "forest", "--format", "mesh", "-o", output, "--json").stdout)
    content = output.read_bytes()
    output.unlink()
    partial = output.with_name(f".forest.tar.{whole['sha256'][:32]}.partial")
    partial.write_bytes(content[:700_000])
    foreign = output.with_name(f".forest.tar.{'0' * 32}.partial")
    foreign.write_bytes(b"of an export that is no more")
    record = json.loads(stone("sequence", "download", "forest", "--format", "mesh", "-o", output, "--json").stdout)
    assert (record["resumed_at_bytes"], output.read_bytes() == content) == (700_000, True)
    assert not partial.exists()
    assert not foreign.exists()


@pytest.mark.parametrize("left", [b"\0" * 700_000, b"\0" * 3_000_000])
def test_a_half_that_is_not_of_this_file_is_dropped(
    platform: Platform, forest: dict[str, Any], tmp_path: Path, left: bytes
) -> None:
    """It is found out at the end, or by the server at once; then nothing of it is kept."""
    made.export(platform, forest["id"], {NAME: CONTENT})
    output = tmp_path / "forest.tar"
    tar = json.loads(stone("sequence", "exports", "forest", "--json").stdout)["exports"][0]["archives"][0]
    output.with_name(f".forest.tar.{tar['sha256'][:32]}.partial").write_bytes(left)
    first = stone("sequence", "download", "forest", "--format", "mesh", "-o", output)
    if first.exit_code:
        assert "damaged_download" in first.stderr
        assert not output.exists()
        assert stone("sequence", "download", "forest", "--format", "mesh", "-o", output).exit_code == 0
    assert sha256(output.read_bytes()).hexdigest() == tar["sha256"]


def test_two_downloads_to_one_place_do_not_meet_and_what_is_not_there_is_refused(
    platform: Platform, forest: dict[str, Any], tmp_path: Path
) -> None:
    made.export(platform, forest["id"], {NAME: CONTENT})
    output = tmp_path / "forest.tar"
    record = json.loads(stone("sequence", "download", "forest", "--format", "mesh", "-o", output, "--json").stdout)
    partial = output.with_name(f".forest.tar.{record['sha256'][:32]}.partial")
    with partial.open("wb") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        assert (
            refused(stone("sequence", "download", "forest", "--format", "mesh", "-o", output)) == "download_under_way"
        )
    assert refused(stone("sequence", "download", "forest", "--format", "kitti", "-o", output)) == "no_export"


class Breaking(httpx.BaseTransport):
    """A server of one file whose connection breaks after `after_bytes` of every answer."""

    def __init__(self, content: bytes, after_bytes: int) -> None:
        self.content, self.after_bytes = content, after_bytes
        self.asked: list[str] = []

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        asked = request.headers.get("range", "")
        self.asked.append(asked)
        start = int(asked[6:-1]) if asked else 0
        headers = {"ETag": f'"{sha256(self.content).hexdigest()}"'}
        return httpx.Response(206 if asked else 200, headers=headers, stream=_Broken(self.content[start:], self))


class _Broken(httpx.SyncByteStream):
    def __init__(self, rest: bytes, of: Breaking) -> None:
        self.rest, self.of = rest, of

    def __iter__(self) -> Iterator[bytes]:
        yield self.rest[: self.of.after_bytes]
        if len(self.rest) > self.of.after_bytes:
            raise httpx.ReadError("the connection broke")


@contextmanager
def breaking(after_bytes: int, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Api, Breaking]]:
    monkeypatch.setattr("stone_client.api.FIRST_PAUSE_S", 0.001)
    transport = Breaking(CONTENT, after_bytes)
    with Api(Server("http://127.0.0.1:1", "token"), transport=transport) as api:
        yield api, transport


def test_a_broken_connection_costs_no_byte_that_had_arrived(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with breaking(300_000, monkeypatch) as (api, transport):
        on_bytes = list[int]()
        fetch(api, "/file", PartialFile(tmp_path / "file"), on_bytes.append)
    assert (tmp_path / "file").read_bytes() == CONTENT
    assert transport.asked == ["", "bytes=300000-", "bytes=600000-", "bytes=900000-"]
    assert on_bytes[-1] == len(CONTENT)


def test_a_server_that_sends_nothing_new_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fetching, "PATIENCE_S", 0.01)
    with breaking(0, monkeypatch) as (api, _), pytest.raises(ServerUnreachableError, match="the connection broke"):
        save(api, "/file", tmp_path / "file")


def test_bytes_that_are_not_the_promised_ones_are_refused_and_not_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with breaking(10**9, monkeypatch) as (api, _):
        (tmp_path / "file").write_bytes(b"x" * 10)
        arriving = PartialFile(tmp_path / "file", sha256(CONTENT).hexdigest())
        with refused_as("damaged_download", match="download it again"):
            fetch(api, "/file", arriving)
    assert (tmp_path / "file").read_bytes() == b""
