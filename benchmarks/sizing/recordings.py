"""The cost of one recording: uploaded to a fresh platform, labelled, with its playback.

**Conventions.** Full rig: 128 × 1800 rays and six cameras at 10 Hz, simulated once and stored. Wall seconds are of this
machine with this number of workers; the disk is the platform's folder, store and scratch files together.
"""

import itertools
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

from sqlalchemy import func, select

from benchmarks.api import database_url
from benchmarks.memory_watch import MemoryWatch
from benchmarks.sizing.costs import MeasuredCosts
from benchmarks.sizing.holdings import MB, bytes_below, holdings_of
from services.runtime.embedded.supervisor import RunningPlatform, running_platform
from services.runtime.orm import Job
from services.runtime.settings import ApiSettings, DatabaseSettings, Settings
from simulator.pipeline import calibration_path
from stone_client.api import Api
from stone_client.credentials import Server
from stone_client.files.bags import hashed_bag
from stone_client.server.job_following import follow
from stone_client.server.sequences import add_recording, ensure_sequence, pin_calibration, start_run

SWEEPS_HZ = 10.0
CHANNELS, COLUMNS = 128, 1800
LOOK_S = 1.0
PLAYBACK_WITHIN_S = 3600.0


@dataclass(frozen=True)
class RecordingCosts:
    """Costs that grow with the frames, and peaks: memory of each program, disk."""

    measured: MeasuredCosts
    most_bytes: dict[str, int]


@dataclass
class DiskWatch:
    """The maximum of the bytes below a folder, sampled every second."""

    folder: Path
    most_bytes: int = 0
    _over: threading.Event = field(default_factory=threading.Event)

    @contextmanager
    def watching(self) -> Iterator[None]:
        thread = threading.Thread(target=self._look, name="disk")
        thread.start()
        try:
            yield
        finally:
            self._over.set()
            thread.join()

    def _look(self) -> None:
        while not self._over.wait(LOOK_S):
            self.most_bytes = max(self.most_bytes, bytes_below(self.folder))


def simulated_rig(folder: Path, frames: int) -> Path:
    """Return the bag of `frames` frames, from an earlier run if it exists."""
    bag = folder / f"rig-{CHANNELS}x{COLUMNS}-{frames}.mcap"
    if not bag.exists():
        folder.mkdir(parents=True, exist_ok=True)
        command = [
            sys.executable,
            "-m",
            "stone_client.main",
            "simulate",
            str(bag),
            "--seconds",
            str(frames / SWEEPS_HZ),
        ]
        command += ["--channels", str(CHANNELS), "--columns", str(COLUMNS)]
        subprocess.run(command, check=True)
    return bag


def recording_costs(bag: Path, frames: int, workers: int) -> RecordingCosts:
    """Upload the bag to a fresh platform on PostgreSQL and wait until all jobs have ended."""
    with TemporaryDirectory(dir=bag.parent) as folder, database_url("postgres") as url:
        data = Path(folder)
        settings = Settings(data_folder=data, workers=workers, database=DatabaseSettings(url), api=ApiSettings(port=0))
        with running_platform(settings) as running:
            before = holdings_of(running.platform)
            disk = DiskWatch(data)
            with MemoryWatch(running) as memory, disk.watching():
                waited_s = _brought_and_labelled(running, bag)
            costs = holdings_of(running.platform).costs_since(before) | waited_s
        most = {name: max(held) for name, held in memory.held.items() if held}
        most["disk"] = disk.most_bytes
        costs["disk while it is labelled, MB"] = disk.most_bytes / MB
        return RecordingCosts(MeasuredCosts(frames, costs), most)


def _brought_and_labelled(running: RunningPlatform, bag: Path) -> dict[str, float]:
    """Return the wall seconds of registration, of labelling, and of playback."""
    moments_s = [time.perf_counter()]
    with Api(Server(running.url, running.keys.token)) as api:
        sequence = ensure_sequence(api, "recorded")
        pin_calibration(api, sequence, calibration_path(bag))
        add_recording(api, sequence, hashed_bag(bag, _silent), _silent)
        moments_s.append(time.perf_counter())
        follow(api, start_run(api, sequence, {})["id"], _silent)
        moments_s.append(time.perf_counter())
    _await_rest(running)
    moments_s.append(time.perf_counter())
    sent_s, labelled_s, rest_s = (b - a for a, b in itertools.pairwise(moments_s))
    return {"upload and reading, wall s": sent_s, "labels, wall s": labelled_s, "playback, wall s": rest_s}


def _await_rest(running: RunningPlatform) -> None:
    """Wait until no job waits or runs. Raises `TimeoutError`."""
    end_s = time.monotonic() + PLAYBACK_WITHIN_S
    unfinished = select(func.count()).select_from(Job).where(Job.finished_ns.is_(None))
    while True:
        with running.platform.database.reading() as session:
            if not session.scalar(unfinished):
                return
        if time.monotonic() > end_s:
            raise TimeoutError(f"jobs are left after {PLAYBACK_WITHIN_S:g} s")
        time.sleep(LOOK_S)


def _silent(_stage: str, _done: int, _total: int) -> None:
    return
