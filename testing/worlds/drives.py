"""Simulated drives and their labels, created once for a whole test run, by the first test that needs them.

**Conventions.** Returned folders must not change; copy them before changing files.
"""

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest

from services.domain.exports.requests import start_export
from services.domain.sequences.label_choices import DEFAULT_PROFILE
from services.ingest.pipeline import SynchroniseOptions
from services.ingest.sequence import opened_sequence
from services.labeler.local_run import LabelOptions, label
from services.labeler.parameters import parameters_for
from services.runtime.database.migrate import upgrade
from services.runtime.orm import Export
from services.runtime.platform import Platform
from services.runtime.store.pack_reading import ExportLocation, file_pieces, locate_export, stored_files
from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate
from testing.once import made_once
from testing.servers.fixtures import make_settings, opened
from testing.worlds.faults.drive import SoundDrive, simulated_drive
from testing.worlds.recording_parts import RecordingPart
from testing.worlds.runs import NAME, Brought, bring_ready, files_of_label, run_all

TINY = SimulateOptions(seconds=1.0, seed=3, channels=16, columns=120, cameras=False)
TWO_PARTS = SimulateOptions(3.4, seed=3, channels=8, columns=90, cameras=False, world_width_m=30.0, lidar_hz=20)
SHORT = SimulateOptions(seconds=1.2, seed=3, channels=16, columns=180, camera_width_px=96, world_width_m=30.0)
SEEN_BY_CAMERAS = SimulateOptions(2.0, channels=16, columns=360, camera_width_px=64, world_width_m=30.0)
THREE_CLOCKS = SimulateOptions(seconds=6.0, seed=1, channels=16, columns=180, camera_width_px=320)
AHEAD_NS = 80_000_000
OF_THREE_CLOCKS = (
    RecordingPart("run.mcap", lambda topic, _time: "camera" not in topic and "radar" not in topic),
    RecordingPart("cameras.mcap", lambda topic, _time: "camera" in topic, AHEAD_NS),
    RecordingPart("radars.bag", lambda topic, _time: "radar" in topic, -AHEAD_NS),
)
IDS = "ids.json"


def drive(factory: pytest.TempPathFactory, options: SimulateOptions = TINY) -> Path:
    """Return the recording of such a drive; its calibration lies beside it."""
    name = f"drive-{sha256(repr(options).encode()).hexdigest()[:12]}"
    return made_once(factory, name, lambda folder: _simulated(folder, options)) / "run.mcap"


def _simulated(folder: Path, options: SimulateOptions) -> None:
    simulate(folder / "run.mcap", options)


def sound_drive(factory: pytest.TempPathFactory) -> SoundDrive:
    """Return the simulated drive for faults."""

    def make(folder: Path) -> None:
        simulated_drive(folder)

    return simulated_drive(made_once(factory, "sound-drive", make))


def labels_of_two_parts(factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Return the label files of the drive `TWO_PARTS`, named as in `Brought.files`."""
    bag = drive(factory, TWO_PARTS)

    def make(folder: Path) -> None:
        with opened_sequence(bag, calibration_path(bag), NAME, SynchroniseOptions()) as opened:
            late = (opened.recording_inputs, opened.late_findings)
            options = LabelOptions(parameters_for(DEFAULT_PROFILE), 2, {}, *late)
            label(opened.sequence, opened.sweeps, folder / "labels", options)

    return files_of_label(made_once(factory, "labels-of-two-parts", make) / "labels")


@contextmanager
def registered_platform(factory: pytest.TempPathFactory, folder: Path) -> Iterator[Brought]:
    """Yield a copy in `folder` of a platform with a sequence, its calibration and its registered recording, `TINY`."""
    bag = drive(factory)

    def make(root: Path) -> None:
        keep_ids(bring_ready(_new_platform(root), bag), root)

    with copied_platform(made_once(factory, "registered-platform", make), folder) as brought:
        yield brought


@contextmanager
def labelled_platform(factory: pytest.TempPathFactory, folder: Path, **groups: Any) -> Iterator[Brought]:
    """Yield a copy in `folder` of a platform with a labelled sequence, `SHORT`; `groups` as in `Settings`."""
    bag = drive(factory, SHORT)

    def make(root: Path) -> None:
        brought = bring_ready(_new_platform(root), bag)
        brought.process()
        run_all(brought.platform)
        keep_ids(brought, root)

    with copied_platform(made_once(factory, "labelled-platform", make), folder, **groups) as brought:
        yield brought


def _new_platform(root: Path) -> Platform:
    platform = opened(make_settings(root), [])
    upgrade(platform.settings)
    return platform


def keep_ids(brought: Brought, root: Path) -> None:
    """Close the platform below `root`, ready to be copied, and write the ids of `brought`."""
    brought.platform.database.close()
    (root / IDS).write_text(json.dumps([brought.owner_id, brought.sequence_id, brought.recording_ids]))


@contextmanager
def copied_platform(root: Path, folder: Path, **groups: Any) -> Iterator[Brought]:
    """Yield the copied sequence of the platform below `root`, on a copy of that platform."""
    shutil.copytree(root, folder, symlinks=True)
    platform = opened(make_settings(folder, **groups), [])
    yield Brought(platform, *json.loads((folder / IDS).read_text()))
    platform.database.close()


def exported(brought: Brought, form: str = "nuscenes") -> dict[str, bytes]:
    """Export the sequence's labels and return the files."""
    with brought.platform.database.transaction() as session:
        export, job = start_export(session, brought.sequence(), form)
        export_id, job_id = export.id, job.id
    run_all(brought.platform)
    assert brought.job(job_id).state == "succeeded", brought.job(job_id).failure
    return exported_files(brought.platform, export_id)


def exported_files(platform: Platform, export_id: str) -> dict[str, bytes]:
    with platform.database.reading() as session:
        located = locate_export(session, session.get_one(Export, export_id))
    return files_at(platform, located)


def files_at(platform: Platform, located: ExportLocation) -> dict[str, bytes]:
    """Return the packed files by their names."""
    stored = stored_files(platform.store, located)
    files, read = stored.files, stored.reader(platform.store)
    return {
        name: b"".join(file_pieces(files, ordinal, (0, int(files.sizes_bytes[ordinal])), read))
        for ordinal, name in enumerate(files.names)
    }
