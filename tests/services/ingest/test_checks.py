"""What the late checks find is said of the sequence once and whole, after what synchronisation said, before labels;
and they leave a picture per camera with the LiDAR's points on it, of the recipe that made the sequence."""

from io import BytesIO
from pathlib import Path

import pytest
from PIL import Image
from sqlalchemy import select

from services.domain.sequences.processing import CHECK, SYNCHRONISE, delete_sequence
from services.ingest import sandboxed_synchronisation
from services.ingest.queue_handlers import handlers
from services.runtime.jobs.control import retry
from services.runtime.jobs.execution import run_next
from services.runtime.jobs.specs import Attempt, Handler, Outcome
from services.runtime.notifications.events import LABELS_UNUSABLE
from services.runtime.orm import Blob, CalibrationRow, Job, NotificationEvent, Preview
from services.runtime.platform import Platform
from simulator.pipeline import calibration_path
from stone.errors import StoneError
from stone.findings import Finding
from stone_recordings.sync.sequence_file import read_sequence
from testing.worlds.drives import SHORT, drive
from testing.worlds.runs import Brought, bring, bring_ready, run_all


def killed_once(kind: str, handler: Handler) -> Handler:
    """The first attempt at the checks has done everything and written nothing when it ends."""

    def run(attempt: Attempt) -> Outcome:
        outcome = handler(attempt)
        if kind == CHECK and attempt.job_id not in killed:
            killed.add(attempt.job_id)
            raise RuntimeError("killed")
        return outcome

    killed: set[str] = set()
    return run


SEEN = Finding("CAL-404", "error", "CAM_FRONT", "its mount is not this camera's")


class UnreadablePicturesError(StoneError):
    """A refusal in the middle of the checks."""

    code = "unreadable"


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drive(tmp_path_factory)


@pytest.fixture
def brought(platform: Platform, bag: Path, monkeypatch: pytest.MonkeyPatch) -> Brought:
    """A sequence whose calibration was valid long ago, and of whose pictures one finding tells."""
    monkeypatch.setattr(sandboxed_synchronisation, "late_findings", lambda *_: (SEEN,))
    brought = bring(platform)
    brought.calibrate(calibration_path(bag))
    brought.add(bag)
    with platform.database.transaction() as session:
        session.scalars(select(CalibrationRow)).one().valid_to_ns = 1
    run_all(platform)
    return brought


def job_of(brought: Brought, root_id: str, kind: str) -> Job:
    (job,) = (job for job in brought.jobs(root_id) if job.kind == kind)
    return job


def codes(job: Job) -> list[str]:
    assert job.result is not None
    return [one["code"] for one in job.result["findings"]]


def errors_told(platform: Platform) -> list[int]:
    with platform.database.reading() as session:
        rows = session.scalars(select(NotificationEvent).where(NotificationEvent.kind == LABELS_UNUSABLE))
        return [row.facts["errors"] for row in rows]


def test_findings_are_whole_once_checked_and_told_once_though_the_checks_were_killed(brought: Brought) -> None:
    root_id = brought.process(stages=("synchronise",))
    run_all(brought.platform, wrap=killed_once)
    assert brought.job(root_id).state == "succeeded"
    so_far, whole = (codes(job_of(brought, root_id, kind)) for kind in (SYNCHRONISE, CHECK))
    assert so_far[-1] == "CAL-418"
    assert "CAL-404" not in so_far
    assert whole == [*so_far[:-1], "CAL-404", "CAL-418"], "what is said of the calibration's time stays last"
    store = brought.platform.store
    files = [read_sequence(b"".join(store.read(f"work/{root_id}/{name}.npz"))) for name in ("sequence", "checked")]
    assert [one.code for one in files[1].findings] == whole
    assert files[1].findings[:-2] == files[0].findings
    assert errors_told(brought.platform) == [1]


def test_a_run_whose_checks_have_not_ended_is_not_done(brought: Brought) -> None:
    root_id = brought.process(stages=("synchronise",))
    assert run_next(brought.platform, "ingest", handlers(brought.platform))
    job = job_of(brought, root_id, SYNCHRONISE)
    assert job.result is not None
    assert (job.state, job.result["is_checked"]) == ("succeeded", False)
    assert (job_of(brought, root_id, CHECK).state, brought.job(root_id).state) == ("queued", "running")


def test_what_the_checks_refuse_fails_the_run_and_a_retry_takes_up_the_checks_alone(
    brought: Brought, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> tuple[Finding, ...]:
        raise UnreadablePicturesError("picture 7 is cut off")

    root_id = brought.process(stages=("synchronise",))
    with monkeypatch.context() as broken:
        broken.setattr(sandboxed_synchronisation, "late_findings", refuse)
        run_all(brought.platform)
    assert (brought.job(root_id).state, brought.job(root_id).failure_code) == ("failed", "unreadable")
    with brought.platform.database.transaction() as session:
        retry(session, root_id, 3)
    run_all(brought.platform)
    assert brought.job(root_id).state == "succeeded"
    assert [job_of(brought, root_id, kind).attempt for kind in (SYNCHRONISE, CHECK)] == [1, 2]


@pytest.fixture
def looked_at(platform: Platform, tmp_path_factory: pytest.TempPathFactory) -> Brought:
    """A sequence with pictures."""
    return bring_ready(platform, drive(tmp_path_factory, SHORT))


def overlays(brought: Brought) -> dict[tuple[str, str], Preview]:
    with brought.platform.database.reading() as session:
        rows = session.scalars(select(Preview).where(Preview.recording_id.is_(None)))
        return {(row.recipe, row.name): row for row in rows}


@pytest.mark.whole
def test_every_camera_has_its_overlay_and_a_killed_attempt_leaves_the_same(looked_at: Brought) -> None:
    """Catches alone overlays of another recipe, or none after a killed attempt."""
    root_id = looked_at.process(stages=("synchronise",))
    run_all(looked_at.platform, wrap=killed_once)
    assert (looked_at.job(root_id).state, looked_at.job(root_id).failure) == ("succeeded", "")
    recipe = looked_at.job(root_id).arguments["recipe"]
    kept = overlays(looked_at)
    assert {of for of, _name in kept} == {recipe}
    assert len(kept) == 6
    with looked_at.platform.database.reading() as session:
        keys = [session.get_one(Blob, row.blob_sha256).object_key for row in kept.values()]
    for key in keys:
        picture = Image.open(BytesIO(b"".join(looked_at.platform.store.read(key))))
        assert picture.format == "JPEG"
    again = looked_at.process(stages=("synchronise",))
    run_all(looked_at.platform)
    assert looked_at.job(again).state == "succeeded"
    assert {at: row.blob_sha256 for at, row in overlays(looked_at).items()} == {
        at: row.blob_sha256 for at, row in kept.items()
    }


@pytest.mark.whole
def test_overlays_go_with_their_sequence(looked_at: Brought) -> None:
    looked_at.process(stages=("synchronise",))
    run_all(looked_at.platform)
    assert overlays(looked_at)
    with looked_at.platform.database.transaction() as session:
        delete_sequence(session, looked_at.sequence())
    with looked_at.platform.database.reading() as session:
        assert session.scalars(select(Preview)).all() == []
