"""Bytes read and stored when a recording with raw images is labelled in place: `python -m benchmarks.in_place`.

One bag of 2.15 GB from a robot that does not compress images: 45 frames of six raw images (41.5 MB) and 230,400 LiDAR
points (6 MB). It is labelled as an MCAP and as a database below a folder, by ranges from an S3 server of this program,
and as an upload. The upload is tried with its images and as the same drive without them. Read is the share of the file
in the page cache afterwards, including the kernel's read-ahead; the cache is emptied before. For S3 it is the requested
bytes. Stored is the maximum of the data folder after any job, each file once, beyond an empty one's. All labels must be
equal.
"""

import ctypes
import mmap
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from rich.console import Console
from rich.table import Table
from sqlalchemy import select

from services.domain.sequences.recordings import add_in_place
from services.runtime.database.migrate import upgrade
from services.runtime.in_place.settings import InPlaceSettings
from services.runtime.jobs.specs import Attempt, Handler, Outcome
from services.runtime.orm import JobLine
from services.runtime.platform import Platform
from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate
from stone_recordings.sync.stored_recording import RecordingPlace
from testing.servers.fixtures import make_settings, opened
from testing.servers.s3 import running_s3
from testing.worlds.raw_pictures import with_raw_pictures
from testing.worlds.runs import Brought, bring, run_all

DRIVE = SimulateOptions(
    seconds=4.5, seed=3, channels=128, columns=1800, camera_width_px=1920, camera_detail="coarse", compression="none"
)
PAGE_BYTES = mmap.PAGESIZE


def main() -> None:
    """Print the table."""
    table = Table("where", "bag, MB", "read, MB", "read", "stored, MB", "stored", "labels")
    with TemporaryDirectory() as folder:
        root = Path(folder)
        drive = root / "drive.mcap"
        simulate(drive, DRIVE)
        (root / "bags").mkdir()
        for name in ("run.mcap", "run.db3"):
            bag = with_raw_pictures(drive, root / "bags" / name)
            with _platform(root, InPlaceSettings(folders=f"bags={root / 'bags'}")) as platform:
                _forget(bag)
                brought, stored_bytes = _labelled(platform, RecordingPlace("bags", name), drive)
                table.add_row(f"folder, {bag.suffix}", *_row(bag, _cached_bytes(bag), stored_bytes, brought))
        bag = root / "bags" / "run.mcap"
        with _platform(root, InPlaceSettings()) as platform:
            brought, stored_bytes = _labelled(platform, bag, drive)
            table.add_row("uploaded, .mcap", *_row(bag, bag.stat().st_size, stored_bytes, brought))
        lidar = root / "lidar.mcap"
        simulate(lidar, replace(DRIVE, cameras=False))
        with _platform(root, InPlaceSettings()) as platform:
            brought, stored_bytes = _labelled(platform, lidar, lidar)
            table.add_row("uploaded, LiDAR only", *_row(lidar, lidar.stat().st_size, stored_bytes, brought))
        with running_s3() as server:
            store = server.settings("recordings")
            os.link(root / "bags" / "run.mcap", server.buckets / "recordings" / "run.mcap")
            server.forget()
            settings = InPlaceSettings(
                buckets="field=recordings",
                s3_endpoint=store.s3_endpoint,
                s3_key_id=store.s3_key_id,
                s3_secret=store.s3_secret,
            )
            with _platform(root, settings) as platform:
                brought, stored_bytes = _labelled(platform, RecordingPlace("field", "run.mcap"), drive)
                table.add_row("bucket, .mcap", *_row(bag, _fetched_bytes(platform), stored_bytes, brought))
    Console().print(table)


@contextmanager
def _platform(root: Path, in_place: InPlaceSettings) -> Iterator[Platform]:
    with TemporaryDirectory(dir=root) as folder:
        platform = opened(make_settings(Path(folder), in_place=in_place), [])
        upgrade(platform.settings)
        yield platform
        platform.database.close()


def _labelled(platform: Platform, recording: RecordingPlace | Path, drive: Path) -> tuple[Brought, int]:
    """Return the sequence labelled from a recording in place, or from an upload; and the maximum stored after a job."""
    empty_bytes, most_bytes = _stored_bytes(platform.settings.root), [0]

    def measured(_kind: str, handler: Handler) -> Handler:
        def run(attempt: Attempt) -> Outcome:
            outcome = handler(attempt)
            most_bytes[0] = max(most_bytes[0], _stored_bytes(platform.settings.root))
            return outcome

        return run

    brought = bring(platform)
    brought.calibrate(calibration_path(drive))
    if isinstance(recording, Path):
        brought.add(recording)
    else:
        with platform.database.transaction() as session:
            row, _job = add_in_place(session, platform.settings.in_place, brought.sequence(), recording)
            brought.recording_ids.append(row.id)
    run_all(platform, wrap=measured)
    brought.process()
    run_all(platform, wrap=measured)
    return brought, most_bytes[0] - empty_bytes


def _row(bag: Path, read_bytes: int, stored_bytes: int, brought: Brought) -> Iterator[str]:
    size_bytes = bag.stat().st_size
    yield f"{size_bytes / 1e6:.1f}"
    for part_bytes in (read_bytes, stored_bytes):
        yield f"{part_bytes / 1e6:.1f}"
        yield f"{part_bytes / size_bytes:.1%}"
    labels = {name: content for name, content in brought.files().items() if name.endswith("labels.npz")}
    lines = (f"{name} {sha256(content).hexdigest()}\n" for name, content in sorted(labels.items()))
    yield f"{len(labels)} frames, {sha256(''.join(lines).encode()).hexdigest()[:12]}"


def _stored_bytes(folder: Path) -> int:
    files = (path.stat() for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
    return sum({(stat.st_dev, stat.st_ino): stat.st_size for stat in files}.values())


def _fetched_bytes(platform: Platform) -> int:
    with platform.database.reading() as session:
        return sum(line.facts["read_bytes"] for line in session.scalars(select(JobLine).filter_by(event="fetched")))


def _forget(path: Path) -> None:
    """Empty the page cache of the file."""
    with path.open("rb") as file:
        os.fsync(file.fileno())
        os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)


def _cached_bytes(path: Path) -> int:
    """Return the bytes of the file in the page cache (mincore(2))."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as mapped:
        view = np.frombuffer(mapped, np.uint8)
        pages = np.zeros(-(-len(view) // PAGE_BYTES), np.uint8)
        address, residency = ctypes.c_void_p(view.ctypes.data), ctypes.c_void_p(pages.ctypes.data)
        if ctypes.CDLL(None, use_errno=True).mincore(address, ctypes.c_size_t(len(view)), residency):
            raise OSError(ctypes.get_errno(), "mincore")
        del view
        return int((pages & 1).sum()) * PAGE_BYTES


if __name__ == "__main__":
    main()
