"""A ZIP behind an address is read by ranges, and refused if its server does not answer them or the file changes."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import httpx
import pytest

from stone_datasets.reading import check_dataset
from stone_datasets.zip_files import open_zip
from stone_local import url_ranges
from stone_local.url_ranges import open_url
from testing.refusals import refused_as
from testing.worlds.released_datasets import ReleasedDataset, write_released_zip

URL = "https://data.example/STONE.zip?key=1"
TWIN = ReleasedDataset(frames=3)


@dataclass
class Shelf(httpx.BaseTransport):
    """A server of one file, by ranges; the first answers fail."""

    content: bytes
    etag: str = '"one"'
    failing: int = 0
    knows_ranges: bool = True
    sent_bytes: list[int] = field(default_factory=list)

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        self.failing -= 1
        if self.failing >= 0:
            return httpx.Response(503)
        if not self.knows_ranges:
            return httpx.Response(200, stream=Endless())
        first, last = map(int, request.headers["Range"].removeprefix("bytes=").split("-"))
        part = self.content[first : last + 1]
        self.sent_bytes.append(len(part))
        said = f"bytes {first}-{first + len(part) - 1}/{len(self.content)}"
        return httpx.Response(206, headers={"Content-Range": said, "ETag": self.etag}, content=part)


class Endless(httpx.SyncByteStream):
    """A body that nobody may read."""

    def __iter__(self) -> Iterator[bytes]:
        raise AssertionError("the whole file is being downloaded")


@pytest.fixture(scope="module")
def content(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return write_released_zip(tmp_path_factory.mktemp("url") / "STONE.zip", TWIN).read_bytes()


def test_a_zip_behind_an_address_is_checked_as_the_file_is(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "STONE.zip").write_bytes(content)
    shelf = Shelf(content, failing=2)
    remote, local = check_dataset(open_url(URL, shelf)), check_dataset(tmp_path / "STONE.zip")
    assert remote.contents is not None
    assert local.contents is not None
    assert remote.contents.as_record() == local.contents.as_record()
    assert max(shelf.sent_bytes) < len(content) / 4


def test_the_index_costs_the_directory_and_a_file_its_own_bytes(content: bytes) -> None:
    shelf = Shelf(content)
    files = open_zip(open_url(URL, shelf))
    directory_bytes = len(content) - int.from_bytes(content[-6:-2], "little")
    assert sum(shelf.sent_bytes) < directory_bytes + 2**17
    span, before = files.span(TWIN.tables.filename("LIDAR_TOP", TWIN.tables.stamp_us(0, 0))), len(shelf.sent_bytes)
    assert span is not None
    span.read(2**24)
    (sent,) = shelf.sent_bytes[before:]
    assert sent < span.size_bytes


def test_a_file_that_changes_or_a_server_without_ranges_is_refused(
    content: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    shelf = Shelf(content)
    ranges = open_url(URL, shelf)
    shelf.etag = '"two"'
    with refused_as("url_changed"):
        ranges.read_at(0, 10)
    with refused_as("url_unreadable", match="did not answer the range"):
        open_url(URL, Shelf(content, knows_ranges=False))
    monkeypatch.setattr(url_ranges, "TRIES", 2)
    with refused_as("url_unreadable", match="status 503"):
        open_url(URL, Shelf(content, failing=2))
    assert ranges.path == Path("STONE.zip")
