"""The readers of exported data as functions of bytes: tars, and the tables of the nuScenes layout.

**Conventions.** Checksums of a tar's heads are repaired before reading, since mutations would fail there otherwise. An
input contains four tables, separated by two zeros, beside one sweep of a few returns.
"""

import io
import json
import tarfile
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from stone_exports.files import FolderFiles
from stone_exports.sweeps import sweeps_in
from stone_exports.tables import TABLES, exports_in

BLOCK_BYTES = 512
TOKEN = "a" * 32
SWEEP = "samples/LIDAR_TOP/s.pcd.bin"
PARTED = ("sensor", "calibrated_sensor", "ego_pose", "sample_data")
ROWS = {
    "sensor": {"token": "s", "channel": "LIDAR_TOP", "modality": "lidar"},
    "calibrated_sensor": {"token": "c", "sensor_token": "s", "translation": [0, 0, 1], "rotation": [1, 0, 0, 0]},
    "ego_pose": {"token": "e", "timestamp": 1, "translation": [9, 9, 0], "rotation": [1, 0, 0, 0]},
    "sample_data": {
        "sample_token": TOKEN,
        "calibrated_sensor_token": "c",
        "ego_pose_token": "e",
        "timestamp": 1,
        "is_key_frame": True,
        "filename": SWEEP,
    },
}


def read_tar(content: bytes) -> None:
    """Read every export in it, and the points of its frame."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "some.tar"
        path.write_bytes(mended(content))
        for files in exports_in(path):
            for sweep in sweeps_in(files, {TOKEN}).values():
                sweep.points_ego()


def read_tables(content: bytes) -> None:
    with TemporaryDirectory() as folder:
        for name, table in zip(PARTED, content.split(b"\0\0", len(PARTED) - 1), strict=False):
            path = Path(folder) / TABLES / f"{name}.json"
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(table)
        (Path(folder) / SWEEP).parent.mkdir(parents=True)
        (Path(folder) / SWEEP).write_bytes(bytes(60))
        for sweep in sweeps_in(FolderFiles(Path(folder)), {TOKEN}).values():
            sweep.points_ego()


def tar_seeds() -> Iterator[tuple[str, bytes]]:
    """Yield each way to write names, for a short export and one below a long folder."""
    for name, form in (("ustar", tarfile.USTAR_FORMAT), ("gnu", tarfile.GNU_FORMAT), ("pax", tarfile.PAX_FORMAT)):
        for root in ("", f"{'r' * 90}/" * 3 if form != tarfile.USTAR_FORMAT else "r/"):
            content = io.BytesIO()
            with tarfile.open(fileobj=content, mode="w", format=form) as tar:
                for path, file in _files().items():
                    member = tarfile.TarInfo(root + path)
                    member.size = len(file)
                    tar.addfile(member, io.BytesIO(file))
            yield f"{name}-{len(root)}", content.getvalue()


def table_seeds() -> Iterator[tuple[str, bytes]]:
    yield "tables", b"\0\0".join(_table(name) for name in PARTED)


def _files() -> dict[str, bytes]:
    return {f"{TABLES}/{name}.json": _table(name) for name in PARTED} | {SWEEP: bytes(60)}


def _table(name: str) -> bytes:
    return b"[\n" + json.dumps(ROWS[name]).encode() + b"\n]\n"


def mended(content: bytes) -> bytes:
    """Return the tar with a correct checksum in every block that looks like a head."""
    mended = bytearray(content)
    for at in range(0, len(mended) - BLOCK_BYTES + 1, BLOCK_BYTES):
        block = mended[at : at + BLOCK_BYTES]
        if block[257:262] == b"ustar":
            block[148:156] = b" " * 8
            mended[at + 148 : at + 156] = b"%06o\0 " % sum(block)
    return bytes(mended)
