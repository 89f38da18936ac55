"""The page refuses by first bytes what the platform refuses, in the same words: both are given the same files.

**Conventions.** What only the platform can tell, whether a bag is inside of a file compressed with zstd, the page lets
pass.
"""

from base64 import b64encode
from pathlib import Path

import pytest

from stone_recordings.bags.errors import CutBagError, NotABagError
from stone_recordings.bags.magic import container_of
from testing.api.serving import Person
from testing.web.browsing import Site

MCAP = b"\x89MCAP0\r\n"
HEADS = {
    "mcap": MCAP + b"\x01more",
    "cut mcap": MCAP[:5],
    "one byte": MCAP[:1],
    "damaged beginning": b"\0" * 600 + MCAP,
    "damaged beginning, zeros behind": b"\xff" * 9 + MCAP + b"\0" * 3_000_000,
    "zeros": b"\0" * 1_100_000,
    "sqlite": b"SQLite format 3\x00rest",
    "cut sqlite": b"SQLite format",
    "ros1": b"#ROSBAG V2.0\nrest",
    "cut ros1": b"#ROSBAG",
    "old ros1": b"#ROSBAG V1.2\n",
    "older ros1": b"#ROSRECORD V1.1\n",
    "nothing": b"",
    "zip": b"PK\x03\x04rest",
    "gzip": b"\x1f\x8b\x08",
    "lz4": b"\x04\x22\x4d\x18rest",
    "bzip2": b"BZh91AY",
    "xz": b"\xfd7zXZ\x00",
    "lfs": b"version https://git-lfs.github.com/spec/v1\n",
    "pcap": b"\xd4\xc3\xb2\xa1\x02",
    "pcapng": b"\x0a\x0d\x0d\x0a\x01",
    "elf": b"\x7fELF\x02",
    "tar": b"a" * 257 + b"ustar" + b"b" * 250,
    "html": b"<!doctype HTML><title>Sign in</title>",
    "html after spaces": b"\r\n\t <HTML>",
    "html within": b"<!-- saved --><html>",
    "xml": b"<?xml version='1.0'?>",
    "tag": b" <bag>",
    "json": b'\n{"error": 403}',
    "list": b"[]",
    "text": b"this is no bag\n" + "Größe".encode(),
    "bytes": b'\x00\x01\x02\x03 and "quotes"',
    "text with a null": b"plain\0text",
}


def refusal(path: Path) -> str:
    """The platform's."""
    try:
        container_of(path)
    except NotABagError as refused:
        return str(refused)
    except CutBagError:
        return ""
    return ""


@pytest.mark.parametrize("has_wal", [False, True], ids=["alone", "with a write-ahead log"])
def test_the_page_and_the_platform_refuse_the_same_files(
    site: Site, curator: Person, tmp_path: Path, has_wal: bool
) -> None:
    expected = {}
    for number, (name, content) in enumerate(HEADS.items()):
        path = tmp_path / f"{number}.db3"
        path.write_bytes(content)
        if has_wal:
            (tmp_path / f"{number}.db3-wal").write_bytes(b"x")
        expected[name] = refusal(path)
    with site.visit(curator) as page:
        page.goto("/sequences/new")
        said = page.evaluate(
            """async ([files, hasWal]) => {
              const at = document.querySelector('script[src*="upload/mount.js"]').src.replace("mount.js", "magic.js");
              const { refusalOf } = await import(at);
              const bytes = (text) => Uint8Array.from(atob(text), (one) => one.charCodeAt(0));
              return Promise.all(files.map((text, at) => refusalOf(new File([bytes(text)], `${at}.db3`), hasWal)));
            }""",
            [[b64encode(content).decode() for content in HEADS.values()], has_wal],
        )
        packed = page.evaluate(
            """async () => {
              const at = document.querySelector('script[src*="upload/mount.js"]').src.replace("mount.js", "magic.js");
              const { refusalOf } = await import(at);
              return refusalOf(new File([Uint8Array.of(0x28, 0xb5, 0x2f, 0xfd, 0)], "x.mcap"), false);
            }"""
        )
    assert dict(zip(HEADS, said, strict=True)) == expected
    assert packed == ""
    assert sum(map(bool, expected.values())) > 20
