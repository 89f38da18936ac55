"""A run in three files, one on a clock of its own: labels and exports are those of the one file that it was.

Catches alone stages and exports that open another recording than the one that was synchronised: without the other
files, or with offsets of another time.
"""

import io
import shutil
from collections.abc import Iterator
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from sqlalchemy import select

from services.domain.sequences.processing import SYNCHRONISE
from services.domain.sequences.recordings import kept_recording, locate_run, remove_recording
from services.ingest.sandboxed_synchronisation import StoredBags, SynchronisationResult, with_description
from services.labeler.export_stage import located_members
from services.runtime.database.migrate import upgrade
from services.runtime.jobs.specs import Attempt, Handler, Outcome
from services.runtime.orm import Artefact, Blob, Job, Recording
from services.runtime.platform import Platform
from services.runtime.sandbox import SandboxCrashedError
from simulator.pipeline import calibration_path
from stone_files.joined_file import JOINED, JoinedFileError, read_joined
from testing.refusals import refused_as
from testing.servers.fixtures import make_settings, opened
from testing.worlds.drives import (
    AHEAD_NS,
    OF_THREE_CLOCKS,
    SHORT,
    THREE_CLOCKS,
    copied_platform,
    drive,
    exported,
    keep_ids,
    labelled_platform,
)
from testing.worlds.recording_parts import RecordingPart, split_into
from testing.worlds.runs import Brought, Interrupted, Wrap, bring, differing, run_all

ELSEWHERE = ("/novatel/", "/radar/")
OFFSETS_NS = {"ins.mcap": -AHEAD_NS}
TOLD = {"report.json", "sequence.npz", "frames.parquet", "joined.json"}
TOLD_IN_EXPORT = {"v1.0-trainval/scene.json", "sha256sum.txt"}
"""What names the files that a sequence was made of; nothing else may differ."""


def is_elsewhere(topic: str, _time_ns: int) -> bool:
    return topic.startswith(ELSEWHERE)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drive(tmp_path_factory, SHORT)


@pytest.fixture(scope="module")
def parts(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ...]:
    """The LiDAR's recording cut in two by its recorder; INS and radars in a file whose clock is 80 ms ahead."""
    cut_ns = 1_749_718_800_600_000_000
    return split_into(
        bag,
        tmp_path_factory.mktemp("parts"),
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


@pytest.fixture(scope="module")
def of_one(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, bytes], dict[str, bytes]]:
    """Labels and export of the one file."""
    with labelled_platform(tmp_path_factory, tmp_path_factory.mktemp("one") / "platform") as brought:
        return brought.files(), exported(brought)


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
    keep_ids(brought, root)
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
    with copied_platform(labelled, tmp_path / "platform") as brought:
        yield brought


def described(brought: Brought, folder: Path) -> Path:
    """A folder with the `joined.json` that was published with the labels."""
    folder.mkdir()
    with brought.platform.database.reading() as session:
        of_labels = select(Blob.object_key).join(Artefact, Artefact.blob_sha256 == Blob.sha256)
        key = session.scalars(of_labels.where(Artefact.name == JOINED)).one()
    shutil.copyfile(brought.platform.store.local(key), folder / JOINED)
    return folder


@pytest.mark.whole
def test_labels_of_three_files_are_those_of_the_one(brought: Brought, of_one: tuple[dict[str, bytes], ...]) -> None:
    ours, theirs = brought.files(), of_one[0]
    assert set(differing(ours, theirs)) == TOLD
    assert [frames_in(files) for files in (ours, theirs)] == [frames_in(theirs)] * 2


def frames_in(files: dict[str, bytes]) -> list[dict[str, object]]:
    return list(pq.read_table(io.BytesIO(files["frames.parquet"])).to_pylist())


@pytest.mark.whole
def test_the_offsets_are_published_with_the_labels_and_told_by_the_job(brought: Brought, tmp_path: Path) -> None:
    members = read_joined(described(brought, tmp_path / "described"))
    assert {member.name: member.offset_ns for member in members} == {"lidar_0.mcap": 0, "lidar_1.mcap": 0, **OFFSETS_NS}
    with brought.platform.database.reading() as session:
        told = session.scalars(select(Job.result).where(Job.kind == "ingest.synchronise")).one()
    assert told is not None
    assert [clock["recording"] for clock in told["clocks"]] == [member.name for member in members]
    assert {finding["code"] for finding in told["findings"]} >= {"SYN-520", "SYN-521"}


@pytest.mark.release
def test_an_export_is_that_of_the_one_file_however_its_recordings_are_called_by_then(
    brought: Brought, parts: tuple[Path, ...], of_one: tuple[dict[str, bytes], ...]
) -> None:
    """Catches alone an export that finds the recordings of a run by their names."""
    with brought.platform.database.transaction() as session:
        remove_recording(session, session.get_one(Recording, brought.recording_ids[0]))
    ins = parts[2]
    assert ins.name == "ins.mcap"
    brought.add(ins, "sent_again.mcap")
    run_all(brought.platform)
    made = exported(brought)
    assert set(differing(made, of_one[1])) == TOLD_IN_EXPORT


@pytest.mark.whole
def test_an_export_whose_recordings_are_not_all_there_names_what_is_missing(brought: Brought, tmp_path: Path) -> None:
    with brought.platform.database.transaction() as session:
        remove_recording(session, session.get_one(Recording, brought.recording_ids[1]))
    with refused_as("recording_deleted", match=r"lidar_1\.mcap"):
        located_members(brought.platform, brought.sequence_id, described(brought, tmp_path / "described"))


def test_a_description_of_other_recordings_opens_nothing(brought: Brought, tmp_path: Path) -> None:
    folder = described(brought, tmp_path / "described")
    with brought.platform.database.reading() as session:
        kept = [kept_recording(session, session.get_one(Recording, one)) for one in brought.recording_ids]
    located = locate_run(brought.platform, kept, folder)
    assert sorted(path.name for path in located.iterdir()) == ["ins.mcap", JOINED, "lidar_0.mcap", "lidar_1.mcap"]
    assert locate_run(brought.platform, list(reversed(kept)), folder) == located
    with pytest.raises(JoinedFileError):
        locate_run(brought.platform, kept[:2], folder)


def test_a_child_that_describes_another_run_is_not_believed(brought: Brought, tmp_path: Path) -> None:
    folder = described(brought, tmp_path / "described")
    made, sha256s = SynchronisationResult({}, {}, {}), {member.name: member.sha256 for member in read_joined(folder)}
    believed = with_description(made, folder, StoredBags((), (), sha256s, {}))
    assert believed.files == {JOINED: folder / JOINED}
    with pytest.raises(SandboxCrashedError):
        with_description(made, folder, StoredBags((), (), {**sha256s, "more.mcap": "ab" * 32}, {}))
    (folder / JOINED).write_text("{}")
    with pytest.raises(SandboxCrashedError):
        with_description(made, folder, StoredBags((), (), sha256s, {}))
    (folder / JOINED).unlink()
    with pytest.raises(SandboxCrashedError):
        with_description(made, folder, StoredBags((), (), sha256s, {}))


@pytest.mark.release
def test_clocks_that_nobody_knows_are_measured_in_the_sandbox(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Catches alone a measurement that needs what a sandboxed child may not open."""
    whole = drive(tmp_path_factory, THREE_CLOCKS)
    brought = bring(platform_in(tmp_path / "platform"))
    brought.calibrate(calibration_path(whole))
    for path in split_into(whole, tmp_path, OF_THREE_CLOCKS):
        brought.add(path)
    run_all(brought.platform)
    root_id = brought.process(stages=("synchronise",))
    run_all(brought.platform)
    (told,) = (job.result for job in brought.jobs(root_id) if job.kind == SYNCHRONISE)
    assert told is not None, brought.job(root_id).failure
    offsets_ns = {clock["recording"]: clock["offset_ns"] for clock in told["clocks"]}
    assert set(offsets_ns) == {part.name for part in OF_THREE_CLOCKS}
    assert all(abs(offsets_ns[part.name] + part.ahead_ns) < 2_000_000 for part in OF_THREE_CLOCKS)
    assert {clock["recording"] for clock in told["clocks"] if "reference" in clock["known_by"]} == {"run.mcap"}
    brought.platform.database.close()
