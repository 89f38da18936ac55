"""Archives as honest tools write them, beyond `numpy.savez_compressed` in Python's `zipfile`."""

import io
import shutil
import subprocess
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.services.eval.attacks import BOTH, HONEST_CASES, TOKENS, Build, frame, grid, written
from tests.services.eval.attacks_npy import HONEST_HEADER, holding, npy
from tests.services.eval.attacks_zip import DESCRIBED, FIRST, PAIR, SECOND, UTF8, unicode_path
from tests.services.eval.raw_zip import Ending, Entry, raw_zip, stretched

UNIX_TIMES = b"UT\5\0\3\0\0\0\0" + b"ux\x0b\0\1\4\0\0\0\0\4\0\0\0\0"  # what Info-ZIP adds to every file


def laid_out(path: Path, folder: str) -> Path:
    """The frames as files, beside the archive to be."""
    root = path.with_suffix(".files")
    (root / folder).mkdir(parents=True)
    for name, npz in BOTH:
        (root / folder / name).write_bytes(npz)
    return root


def made_archive(path: Path) -> None:
    shutil.make_archive(str(path.with_suffix("")), "zip", laid_out(path, "a/b"), "a")


def info_zip(*options: str, piped: bool = False) -> Build:
    """By the program itself; `piped` makes it write sizes behind the data."""

    def build(path: Path) -> None:
        root = laid_out(path, "run")
        if piped:
            path.write_bytes(
                subprocess.run(["zip", *options, "-", "run"], cwd=root, check=True, capture_output=True).stdout
            )
        else:
            subprocess.run(["zip", *options, str(path), "run"], cwd=root, check=True, capture_output=True)

    return build


def forced_wide(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as opened:
        for name, npz in BOTH:
            with opened.open(name, "w", force_zip64=True) as member:
                member.write(npz)


def streamed(path: Path) -> None:
    """To something that cannot seek: sizes and CRC follow the data."""

    class Pipe(io.RawIOBase):
        written = b""

        def writable(self) -> bool:
            return True

        def write(self, chunk: object) -> int:
            self.written += bytes(chunk)  # type: ignore[call-overload]
            return len(bytes(chunk))  # type: ignore[call-overload]

    pipe = Pipe()
    with zipfile.ZipFile(pipe, "w", zipfile.ZIP_DEFLATED) as opened:
        for name, npz in BOTH:
            with opened.open(name, "w", force_zip64=name == BOTH[0][0]) as member:
                member.write(npz)
    path.write_bytes(pipe.written)


def appended(path: Path) -> None:
    for index, (name, npz) in enumerate(BOTH):
        with zipfile.ZipFile(path, "a" if index else "w") as opened:
            opened.writestr(name, npz)


def saved_by_pathlike(path: Path) -> None:
    root = laid_out(path, "x")
    with zipfile.ZipFile(path, "w") as opened:
        for token in TOKENS:
            file = root / f"{token}.npz"
            np.savez(file, semantics=grid())
            opened.write(file, file.name)


def in_folder(folder: bytes, *, flags: int = 0, extra: Callable[[bytes], bytes] = lambda name: b"") -> Build:
    names = [folder + b"/" + entry.name for entry in PAIR]
    moved = [replace(entry, name=name, flags=flags, extra=extra(name)) for entry, name in zip(PAIR, names, strict=True)]
    return written(raw_zip([Entry(folder + b"/", b"", flags=flags, extra=extra(folder + b"/")), *moved]))


def told_behind(descriptor: bytes) -> Build:
    local = {"crc32": 0, "packed": 0, "unpacked": 0}
    return written(raw_zip([replace(entry, flags=DESCRIBED, local=local, between=descriptor) for entry in PAIR]))


TOOLS: Mapping[str, Build] = {
    **HONEST_CASES,
    "shutil.make_archive": made_archive,
    "zipfile with wide sizes": forced_wide,
    "zipfile into a pipe": streamed,
    "zipfile, appended to": appended,
    "numpy.savez by path": saved_by_pathlike,
    "wide end record": written(raw_zip(PAIR, Ending(wide={}))),
    "wide end record alone": written(
        raw_zip(
            PAIR,
            Ending(wide={}, narrow={"entries": 2**16 - 1, "here": 2**16 - 1, "bytes": 2**32 - 1, "offset": 2**32 - 1}),
        )
    ),
    "wide sizes": written(raw_zip([stretched(FIRST), stretched(SECOND)])),
    "times of Info-ZIP": written(raw_zip([replace(FIRST, extra=UNIX_TIMES[:9], local_extra=UNIX_TIMES), SECOND])),
    "a comment": written(raw_zip(PAIR, Ending(comment=b"made by hand"))),
    "folder in code page 437": in_folder(b"l\x84ufe"),
    "folder in UTF-8": in_folder("läufe".encode(), flags=UTF8),
    "folder in UTF-8, unannounced": in_folder("läufe".encode()),
    "folder with a second name": in_folder(
        b"l_ufe", extra=lambda name: unicode_path(name, name.replace(b"l_ufe", "läufe".encode()))
    ),
    "sizes behind, 12 bytes": told_behind(bytes(12)),
    "sizes behind, 24 bytes": told_behind(b"PK\7\x08" + bytes(20)),
    "header of version 2": holding(npy(HONEST_HEADER.ljust(117) + "\n", version=2))(),
    "header of version 3 in another order": holding(
        npy("{'shape':(256,256,32),'fortran_order':False,'descr':\"u1\"}", version=3)
    )(),
    "all free, stored": frame(raw_zip([Entry(b"arr_0.npy", npy(HONEST_HEADER))])),
}
INFO_ZIP: Mapping[str, Build] = {
    "zip -r": info_zip("-r"),
    "zip -r0": info_zip("-r0"),
    "zip -rD": info_zip("-rD"),
    "zip -rX": info_zip("-rX"),
    "zip into a pipe": info_zip("-r", piped=True),
    "zip with wide sizes": info_zip("-r", "-fz"),
}
