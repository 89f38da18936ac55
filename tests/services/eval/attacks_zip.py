"""Hostile archives: lies in wide records, names, headers that disagree, bytes of no file, archives in archives.

**Conventions.** As in `attacks.py`: a case is the codes it must be refused with (each at least once, no others) and
what builds it.
"""

import io
import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from tests.services.eval.attacks import BOTH, HONEST, TOKENS, Build, frame, written
from tests.services.eval.raw_zip import CENTRAL_FIELDS, RECORD, WIDE, Ending, Entry, raw_zip, stretched, wide_extra

FIRST, SECOND = (Entry(f"{token}.npz".encode(), HONEST) for token in TOKENS)
PAIR = (FIRST, SECOND)
UTF8 = 1 << 11
DESCRIBED = 1 << 3
MILLION = 1_000_000
PNG = b"\x89PNG\r\n\x1a\n" + bytes(100)

Case = tuple[str, Callable[[], Build]]


def raw(*entries: Entry, **ending: object) -> Callable[[], Build]:
    return lambda: written(raw_zip(entries, Ending(**ending)))  # type: ignore[arg-type]


def lying(**central: int) -> Callable[[], Build]:
    """The directory lies about the first file."""
    return raw(replace(FIRST, central=central), SECOND)


def lying_locally(**local: int) -> Callable[[], Build]:
    return raw(replace(FIRST, local=local), SECOND)


def wide_lie(**wide: int) -> Callable[[], Build]:
    return raw(*PAIR, wide=wide)


def named(*names: bytes, flags: int = 0) -> Callable[[], Build]:
    """The two honest frames under other names."""
    return raw(*(replace(entry, name=name, flags=flags) for entry, name in zip(PAIR, names, strict=True)))


def behind(folder: bytes, flags: int = 0) -> Callable[[], Build]:
    """Both frames in this folder."""
    return named(*(folder + b"/" + entry.name for entry in PAIR), flags=flags)


def unicode_path(name: bytes, path: bytes) -> bytes:
    return struct.pack("<2HBI", 0x7075, 5 + len(path), 1, zlib.crc32(name)) + path


def crowd(entries: int, said: int | None = None) -> Callable[[], Build]:
    """So many records of one empty file, all of them there, announced as `said`."""

    def build(path: Path) -> None:
        facts = Entry(b"", b"").facts(b"x" * 10, b"")
        record = RECORD.pack(b"PK\1\2", *(facts[name] for name in CENTRAL_FIELDS)) + b"x" * 10
        announced = entries if said is None else said
        whole = raw_zip([], Ending(wide={"entries": announced, "here": announced, "bytes": len(record) * entries}))
        with path.open("wb") as file:
            for _ in range(entries // 1000):
                file.write(record * 1000)
            wide = bytearray(whole)
            struct.pack_into("<Q", wide, 56 + 8, len(record) * entries)  # the locator
            struct.pack_into("<2H2I", wide, 76 + 8, 2**16 - 1, 2**16 - 1, WIDE, WIDE)
            file.write(wide)

    return lambda: build


def nested(levels: int) -> bytes:
    inner = raw_zip(PAIR)
    for level in range(levels):
        inner = raw_zip([Entry(f"{level}.zip".encode(), inner)])
    return inner


def quine() -> bytes:
    """An archive whose member's bytes are the archive itself, by a directory that calls all of it the payload."""
    whole = raw_zip([Entry(b"q.zip", b"")])
    size = len(whole)
    return raw_zip([Entry(b"q.zip", b"", central={"packed": size, "unpacked": size})])


def folders(count: int) -> Sequence[Entry]:
    return [Entry(b"run/", b"")] * count + [replace(entry, name=b"run/" + entry.name) for entry in PAIR]


def inside(npz: Callable[[], bytes]) -> Callable[[], Build]:
    return lambda: frame(npz())


def zip_in_zipfile() -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as opened:
        for name, payload in BOTH:
            opened.writestr(name, payload)
    return file.getvalue()


STRANGE = "unexpected_file missing_frame"
WIDE_LIES: Mapping[str, Case] = {
    "wide record with 3 files": ("unsupported_zip", wide_lie(entries=3, here=3)),
    "wide record with 2**63 files": ("unsupported_zip", wide_lie(entries=2**63, here=2**63)),
    "wide record with files elsewhere": ("unsupported_zip", wide_lie(here=1)),
    "wide record on disk 1": ("unsupported_zip", wide_lie(disk=1)),
    "wide record of directory at 2**63": ("truncated", wide_lie(offset=2**63)),
    "wide record of directory of 2**64 - 1 bytes": ("truncated", wide_lie(bytes=2**64 - 1)),
    "wide record of size 2**64 - 1": ("truncated", wide_lie(size=2**64 - 1)),
    "wide record with a tail of no kind": ("truncated", raw(*PAIR, wide={}, behind_wide=b"tail")),
    "locator to nowhere": ("truncated", raw(*PAIR, wide={}, locator={"offset": 2**64 - 1})),
    "locator to another place": ("truncated", raw(*PAIR, wide={}, locator={"offset": 0})),
    "locator of two disks": ("unsupported_zip", raw(*PAIR, wide={}, locator={"disks": 2})),
    "both ends disagree": ("unsupported_zip", raw(*PAIR, wide={}, narrow={"entries": 1, "here": 1})),
    "both ends disagree on the place": ("unsupported_zip", raw(*PAIR, wide={}, narrow={"offset": 0})),
    "saturated without a wide record": ("truncated", raw(*PAIR, narrow={"offset": WIDE})),
    "wide size beyond the file": ("overlapping_files", raw(stretched(FIRST, packed=2**40, unpacked=2**40), SECOND)),
    "wide size of 2**64 - 1": (
        "overlapping_files",
        raw(stretched(FIRST, packed=2**64 - 1, unpacked=2**64 - 1), SECOND),
    ),
    "wide unpacked size of 2**62": ("too_large", raw(stretched(replace(FIRST, method=8), unpacked=2**62), SECOND)),
    "wide sizes missing": ("truncated", lying(packed=WIDE, unpacked=WIDE)),
    "wide offset missing": ("truncated", raw(replace(FIRST, central={"offset": WIDE}, extra=wide_extra()), SECOND)),
    "wide offset of 2**63": (
        "overlapping_files",
        raw(replace(FIRST, central={"offset": WIDE}, extra=wide_extra(2**63)), SECOND),
    ),
    "two wide fields": ("unsupported_zip", raw(replace(stretched(FIRST), extra=wide_extra(1, 1) * 2), SECOND)),
    "wide field longer than the extra": ("truncated", raw(replace(FIRST, extra=b"\1\0\xff\xff"), SECOND)),
    "wide local size of another": (
        "unsupported_zip",
        raw(replace(stretched(FIRST), local_extra=wide_extra(7, 7)), SECOND),
    ),
}
NAMES: Mapping[str, Case] = {
    "name in no UTF-8": ("unsupported_zip", behind(b"\xff\xfe", flags=UTF8)),
    "overlong UTF-8": ("unsupported_zip", behind(b"\xc0\xae\xc0\xae", flags=UTF8)),
    "control characters": (STRANGE, behind(b"\x1b[31m")),
    "writing turned round": (STRANGE, behind("\u202egpj".encode(), flags=UTF8)),
    "NUL behind the name": (STRANGE, named(*(entry.name + b"\0.txt" for entry in PAIR))),
    "NUL in the folder": (STRANGE, behind(b"run\0", flags=0)),
    "absolute path": (STRANGE, behind(b"/etc")),
    "path upwards": (STRANGE, behind(b"run/../../etc")),
    "backslashes": ("other_layout", named(*(b"run\\" + entry.name for entry in PAIR))),
    "upper case": ("other_layout", named(*(entry.name.upper() for entry in PAIR))),
    "letters that look alike": (STRANGE, raw(replace(FIRST, name=b"\xd0\xb0" * 32 + b".npz", flags=UTF8), SECOND)),
    "a name of 60,000 bytes": ("too_large", raw(*PAIR, Entry(b"n" * 60_000, b""))),
    "a name of no bytes": ("unexpected_file", raw(*PAIR, Entry(b"", b""))),
    "a second name in an extra field": (
        "unsupported_zip",
        raw(replace(FIRST, extra=unicode_path(FIRST.name, SECOND.name)), SECOND),
    ),
    "resource forks": ("unexpected_file", raw(*PAIR, Entry(b"__MACOSX/._" + FIRST.name, b"fork"))),
}
HEADERS: Mapping[str, Case] = {
    "local name of the other frame": ("unsupported_zip", raw(replace(FIRST, local_name=SECOND.name), SECOND)),
    "local method differs": ("unsupported_zip", lying_locally(method=8)),
    "local size differs": ("unsupported_zip", lying_locally(unpacked=7)),
    "local size unknown, nothing behind": ("unsupported_zip", lying_locally(packed=0, unpacked=0)),
    "locally encrypted": ("unsupported_zip", lying_locally(flags=1)),
    "local extra field over the data": ("truncated", raw(FIRST, replace(SECOND, local={"extra_bytes": 900}))),
    "local extra field of 60,000 bytes": ("too_large", lying_locally(extra_bytes=60_000)),
    "directory says less": ("unsupported_zip", lying(packed=100, unpacked=100)),
    "directory says more": ("overlapping_files", lying(packed=2**31, unpacked=2**31)),
    "stored of two sizes": ("unsupported_zip", lying(unpacked=2**31)),
    "offset into another file": ("overlapping_files", raw(FIRST, replace(SECOND, central={"offset": 40}))),
    "offset into the directory": ("overlapping_files", raw(FIRST, replace(SECOND, central={"offset": 2**32 - 2}))),
    "no header at the offset": (
        "truncated",
        raw(replace(FIRST, between=b"gap"), replace(SECOND, central={"offset": 30 + 36 + len(HONEST)})),
    ),
    "two names for one file": (
        "overlapping_files",
        raw(FIRST, replace(FIRST, name=SECOND.name, central={"offset": 0})),
    ),
    "file on disk 3": ("unsupported_zip", lying(disk=3)),
    "a described file that breaks off": (
        "unsupported_zip",
        raw(replace(FIRST, flags=DESCRIBED, central={"packed": 50, "unpacked": 50}), SECOND),
    ),
    "a fifo": (
        "unexpected_file",
        raw(*PAIR, Entry(b"pipe", b"", central={"made_by": 0x314, "attributes": 0o010644 << 16})),
    ),
    "a link of macOS": ("symlink", lying(made_by=0x1314, attributes=0o120777 << 16)),
}
STOWAWAYS: Mapping[str, Case] = {
    "a picture before it": ("unsupported_zip", raw(*PAIR, prefix=PNG)),
    "a picture before it, offsets unaware": ("truncated", lambda: written(PNG + raw_zip(PAIR))),
    "bytes between two files": ("unsupported_zip", raw(replace(FIRST, between=b"stow"), SECOND)),
    "bytes before the directory": ("unsupported_zip", raw(FIRST, replace(SECOND, between=PNG))),
    "bytes behind the end": ("not_zip", raw(*PAIR, behind=PNG)),
    "an end record in the comment": ("truncated", raw(*PAIR, comment=raw_zip([]) + b"tail")),
    "another archive in the comment": ("truncated", raw(*PAIR, comment=raw_zip(PAIR))),
    "two archives": ("truncated", lambda: written(raw_zip(PAIR) + raw_zip(PAIR))),
    "bytes in a folder": ("unexpected_file", raw(Entry(b"run/", b"stow"), *folders(0))),
    "bytes packed to nothing in a folder": (
        "unexpected_file",
        raw(Entry(b"run/", b"stow", method=8, central={"unpacked": 0}), *folders(0)),
    ),
    "an archive in an archive": (STRANGE, lambda: written(nested(1))),
    "an archive in twenty": (STRANGE, lambda: written(nested(20))),
    "an archive that holds itself": ("overlapping_files", lambda: written(quine())),
    "a submission as a frame": ("missing_array", inside(zip_in_zipfile)),
    "an archive as a grid": ("too_large", inside(lambda: raw_zip([Entry(b"semantics.npy", bytes(10**7) + nested(1))]))),
    "a million files": ("too_large", crowd(MILLION)),
    "a million files called two": ("too_large", crowd(MILLION, 2)),
    "70,000 files called 4,464": ("too_large", crowd(70_000, 70_000 % 2**16)),
    "2,000 folders": ("too_large", raw(*folders(2000))),
}
ZIP_CASES = {**WIDE_LIES, **NAMES, **HEADERS, **STOWAWAYS}
