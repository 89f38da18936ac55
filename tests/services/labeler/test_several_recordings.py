"""A run in three files, one on a clock of its own: labels and exports are those of the one file that it was.

Catches alone stages and exports that open another recording than the one that was synchronised: without the other
files, or with offsets of another time.
"""

import io
import json
import os
import shutil
import signal
from collections.abc import Iterator
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from sqlalchemy import select

from services.domain.exports.requests import start_export
from services.domain.sequences import later_recordings
from services.domain.sequences.later_recordings import follow_recordings
from services.domain.sequences.processing import PROCESS, SYNCHRONISE, start_processing
from services.domain.sequences.recording_sources import kept_recording, locate_run
from services.domain.sequences.recordings import remove_recording
from services.ingest.sandboxed_synchronisation import StoredBags, SynchronisationResult, with_description
from services.labeler.recordings import RecordingDeletedError, located_members
from services.runtime.database.migrate import upgrade
from services.runtime.jobs.specs import Attempt, Handler, Outcome
from services.runtime.orm import Artefact, Blob, Export, Job, Recording
from services.runtime.platform import Platform
from services.runtime.sandbox import SandboxCrashedError
from services.runtime.store.pack_archive import locate_export, stored_files
from services.runtime.store.pack_reading import file_pieces
from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate
from stone_files.joined_file import JOINED, JoinedFileError, read_joined
from testing.servers.fixtures import make_settings, opened
from testing.worlds.recording_parts import RecordingPart, split_into
from testing.worlds.runs import Brought, Interrupted, Wrap, bring, bring_ready, run_all

RUN = SimulateOptions(seconds=2.0, seed=3, channels=16, columns=180, cameras=False)
AHEAD_NS = 80_000_000
ELSEWHERE = ("/novatel/", "/radar/")
OFFSETS_NS = {"ins.mcap": -AHEAD_NS}
TOLD = {"report.json", "sequence.npz", "frames.parquet", "joined.json"}
TOLD_IN_EXPORT = {"v1.0-trainval/scene.json", "sha256sum.txt"}
"""What names the files that a sequence was made of; nothing else may differ."""


def is_elsewhere(topic: str, _time_ns: int) -> bool:
    return topic.startswith(ELSEWHERE)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("field") / "run.mcap"
    simulate(path, RUN)
    return path


@pytest.fixture(scope="module")
def parts(bag: Path) -> tuple[Path, ...]:
    """The LiDAR's recording cut in two by its recorder; INS and radars in a file whose clock is 80 ms ahead."""
    cut_ns = 1_749_718_801_300_000_000
    return split_into(
        bag,
        bag.parent,
        (
            RecordingPart("lidar_0.mcap", lambda topic, ns: not is_elsewhere(topic, ns) and ns < cut_ns),
            RecordingPart("lidar_1.mcap", lambda topic, ns: not is_elsewhere(topic, ns) and ns >= cut_ns),
            RecordingPart("ins.mcap", is_elsewhere, AHEAD_NS),
        ),
    )


def platform_in(folder: Path) -> Platform:
    platform = opened(make_settings(folder), [])
    upgrade(platform.settings)
    return platform


def exported(brought: Brought) -> dict[str, bytes]:
    """The files of a nuscenes export."""
    with brought.platform.database.transaction() as session:
        export, _ = start_export(session, brought.sequence(), "nuscenes")
    run_all(brought.platform)
    with brought.platform.database.reading() as session:
        located = locate_export(session, session.get_one(Export, export.id))
    stored = stored_files(brought.platform.store, located)
    files, read = stored.files, stored.reader(brought.platform.store)
    return {
        name: b"".join(file_pieces(files, ordinal, (0, int(files.sizes_bytes[ordinal])), read))
        for ordinal, name in enumerate(files.names)
    }


@pytest.fixture(scope="module")
def of_one(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, bytes], dict[str, bytes]]:
    """Labels and export of the one file."""
    brought = bring_ready(platform_in(tmp_path_factory.mktemp("one")), bag)
    brought.process()
    run_all(brought.platform)
    made = brought.files(), exported(brought)
    brought.platform.database.close()
    return made


@pytest.fixture(scope="module")
def labelled(bag: Path, parts: tuple[Path, ...], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data folder of a platform with labels of the three files, whose synchronising was cut off twice."""
    root = tmp_path_factory.mktemp("three")
    platform = platform_in(root)
    brought = bring(platform)
    brought.calibrate(calibration_path(bag))
    for part in reversed(parts):
        brought.add(part)
    run_all(platform)
    brought.process(clock_offsets_ns=OFFSETS_NS)
    run_all(platform, wrap=cut_off_twice())
    platform.database.close()
    (root / "ids.json").write_text(json.dumps([brought.owner_id, brought.sequence_id, brought.recording_ids]))
    return root


def cut_off_twice() -> Wrap:
    """Synchronising ends early at first, then with everything done but nothing said."""
    tries: list[str] = []

    def wrap(kind: str, handler: Handler) -> Handler:
        def run(attempt: Attempt) -> Outcome:
            if kind != "ingest.synchronise" or len(tries) == 2:
                return handler(attempt)
            tries.append(attempt.job_id)
            handler(Interrupted(attempt) if len(tries) == 1 else attempt)
            raise RuntimeError("cut off at its end")

        return run

    return wrap


@pytest.fixture
def brought(labelled: Path, tmp_path: Path) -> Iterator[Brought]:
    """A copy of that platform."""
    shutil.copytree(labelled, tmp_path / "platform", symlinks=True)
    platform = opened(make_settings(tmp_path / "platform"), [])
    owner_id, sequence_id, recording_ids = json.loads((tmp_path / "platform" / "ids.json").read_text())
    yield Brought(platform, owner_id, sequence_id, recording_ids)
    platform.database.close()


def described(brought: Brought, folder: Path) -> Path:
    """A folder with the `joined.json` that was published with the labels."""
    folder.mkdir()
    with brought.platform.database.reading() as session:
        of_labels = select(Blob.object_key).join(Artefact, Artefact.blob_sha256 == Blob.sha256)
        key = session.scalars(of_labels.where(Artefact.name == JOINED)).one()
    shutil.copyfile(brought.platform.store.local(key), folder / JOINED)
    return folder


def differing(ours: dict[str, bytes], theirs: dict[str, bytes]) -> set[str]:
    return {name for name in ours.keys() | theirs.keys() if ours.get(name) != theirs.get(name)}


def test_labels_of_three_files_are_those_of_the_one(brought: Brought, of_one: tuple[dict[str, bytes], ...]) -> None:
    ours, theirs = brought.files(), of_one[0]
    assert differing(ours, theirs) == TOLD
    assert [frames_in(files) for files in (ours, theirs)] == [frames_in(theirs)] * 2


def frames_in(files: dict[str, bytes]) -> list[dict[str, object]]:
    return list(pq.read_table(io.BytesIO(files["frames.parquet"])).to_pylist())


def test_the_offsets_are_published_with_the_labels_and_told_by_the_job(brought: Brought, tmp_path: Path) -> None:
    members = read_joined(described(brought, tmp_path / "described"))
    assert {member.name: member.offset_ns for member in members} == {"lidar_0.mcap": 0, "lidar_1.mcap": 0, **OFFSETS_NS}
    with brought.platform.database.reading() as session:
        told = session.scalars(select(Job.result).where(Job.kind == "ingest.synchronise")).one()
    assert told is not None
    assert [clock["recording"] for clock in told["clocks"]] == [member.name for member in members]
    assert {finding["code"] for finding in told["findings"]} >= {"SYN-520", "SYN-521"}


def test_an_export_is_that_of_the_one_file_however_its_recordings_are_called_by_then(
    brought: Brought, parts: tuple[Path, ...], of_one: tuple[dict[str, bytes], ...]
) -> None:
    with brought.platform.database.transaction() as session:
        remove_recording(session, session.get_one(Recording, brought.recording_ids[0]))
    ins = parts[2]
    assert ins.name == "ins.mcap"
    brought.add(ins, "sent_again.mcap")
    run_all(brought.platform)
    made = exported(brought)
    assert differing(made, of_one[1]) == TOLD_IN_EXPORT


def test_an_export_whose_recordings_are_not_all_there_names_what_is_missing(brought: Brought, tmp_path: Path) -> None:
    with brought.platform.database.transaction() as session:
        remove_recording(session, session.get_one(Recording, brought.recording_ids[1]))
    with pytest.raises(RecordingDeletedError, match=r"recording lidar_1\.mcap was deleted"):
        located_members(brought.platform, brought.sequence_id, described(brought, tmp_path / "described"))


def test_a_description_of_other_recordings_opens_nothing(brought: Brought, tmp_path: Path) -> None:
    folder = described(brought, tmp_path / "described")
    with brought.platform.database.reading() as session:
        kept = [kept_recording(session, session.get_one(Recording, one)) for one in brought.recording_ids]
    located = locate_run(brought.platform, kept, folder)
    assert sorted(path.name for path in located.iterdir()) == ["ins.mcap", JOINED, "lidar_0.mcap", "lidar_1.mcap"]
    assert locate_run(brought.platform, list(reversed(kept)), folder) == located
    with pytest.raises(JoinedFileError, match=r"it is of ins\.mcap, .*, the run of ins\.mcap, lidar_1\.mcap"):
        locate_run(brought.platform, kept[:2], folder)


def test_a_child_that_describes_another_run_is_not_believed(brought: Brought, tmp_path: Path) -> None:
    folder = described(brought, tmp_path / "described")
    made, sha256s = SynchronisationResult({}, {}), {member.name: member.sha256 for member in read_joined(folder)}
    believed = with_description(made, folder, StoredBags((), (), sha256s, {}))
    assert believed.files == {JOINED: folder / JOINED}
    with pytest.raises(SandboxCrashedError, match="joined other recordings"):
        with_description(made, folder, StoredBags((), (), {**sha256s, "more.mcap": "ab" * 32}, {}))
    (folder / JOINED).write_text("{}")
    with pytest.raises(SandboxCrashedError, match="otherwise than is known"):
        with_description(made, folder, StoredBags((), (), sha256s, {}))
    (folder / JOINED).unlink()
    with pytest.raises(SandboxCrashedError, match="left no description"):
        with_description(made, folder, StoredBags((), (), sha256s, {}))


def killed_in_the_middle(root: Path) -> None:
    """A sweeper's turn that dies when the run's rows are written and nothing is committed."""

    def started_then_killed(*arguments: Any) -> Job:
        start_processing(*arguments)
        os.kill(os.getpid(), signal.SIGKILL)
        raise AssertionError

    later_recordings.start_processing = started_then_killed  # type: ignore[assignment]
    later_recordings.follow_recordings(opened(make_settings(root), []))


def test_a_sweeper_that_is_killed_while_it_starts_the_run_leaves_it_to_the_next(
    brought: Brought, bag: Path, tmp_path: Path
) -> None:
    brought.add(bag, "whole.mcap")
    run_all(brought.platform)
    child = get_context("spawn").Process(target=killed_in_the_middle, args=(tmp_path / "platform",))
    child.start()
    child.join(300)
    assert child.exitcode == -signal.SIGKILL
    assert [follow_recordings(brought.platform) for _ in range(3)] == [1, 0, 0]
    with brought.platform.database.reading() as session:
        runs = session.scalars(select(Job).where(Job.kind == PROCESS).order_by(Job.id)).all()
    assert [len(run.arguments["recording_ids"]) for run in runs] == [3, 4]
    assert runs[1].arguments["clock_offsets_ns"] == OFFSETS_NS


def test_clocks_that_nobody_knows_are_measured_in_the_sandbox(tmp_path: Path) -> None:
    """Catches alone a measurement that needs what a sandboxed child may not open."""
    rig = SimulateOptions(seconds=6.0, seed=1, channels=16, columns=180, camera_width_px=320)
    simulate(tmp_path / "whole.mcap", rig)
    files = (
        RecordingPart("run.mcap", lambda topic, _: "camera" not in topic and "radar" not in topic),
        RecordingPart("cameras.mcap", lambda topic, _: "camera" in topic, AHEAD_NS),
        RecordingPart("radars.bag", lambda topic, _: "radar" in topic, -AHEAD_NS),
    )
    brought = bring(platform_in(tmp_path / "platform"))
    brought.calibrate(calibration_path(tmp_path / "whole.mcap"))
    for path in split_into(tmp_path / "whole.mcap", tmp_path, files):
        brought.add(path)
    run_all(brought.platform)
    root_id = brought.process(stages=("synchronise",))
    run_all(brought.platform)
    (told,) = (job.result for job in brought.jobs(root_id) if job.kind == SYNCHRONISE)
    assert told is not None, brought.job(root_id).failure
    offsets_ns = {clock["recording"]: clock["offset_ns"] for clock in told["clocks"]}
    assert set(offsets_ns) == {part.name for part in files}
    assert all(abs(offsets_ns[part.name] + part.ahead_ns) < 2_000_000 for part in files)
    assert {clock["recording"] for clock in told["clocks"] if "reference" in clock["known_by"]} == {"run.mcap"}
    brought.platform.database.close()
