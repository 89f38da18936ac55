"""What the late checks find is said of the sequence once and whole, after what synchronisation said, before labels;
and they leave a picture per camera with the LiDAR's points on it, of the recipe that made the sequence."""

from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

import pytest
from PIL import Image
from sqlalchemy import delete, select

from services.domain.sequences.processing import CHECK, SYNCHRONISE, delete_sequence
from services.ingest import sandboxed_synchronisation
from services.ingest.queue_handlers import handlers
from services.runtime.jobs.control import retry
from services.runtime.jobs.execution import run_next
from services.runtime.notifications.events import LABELS_UNUSABLE
from services.runtime.orm import Blob, CalibrationRow, Job, NotificationEvent, Preview
from services.runtime.platform import Platform
from stone.errors import StoneError
from stone.findings import Finding
from stone_recordings.sync.sequence_file import read_sequence
from testing.worlds.drives import labelled_platform, registered_platform
from testing.worlds.runs import Brought, lost_once, run_all

SEEN = Finding("CAL-404", "error", "CAM_FRONT", "its mount is not this camera's")


class UnreadablePicturesError(StoneError):
    """A refusal in the middle of the checks."""

    code = "unreadable"


@pytest.fixture
def brought(
    tmp_path_factory: pytest.TempPathFactory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Brought]:
    """A sequence whose calibration was valid long ago, and of whose pictures one finding tells."""
    monkeypatch.setattr(sandboxed_synchronisation, "late_findings", lambda *_: (SEEN,))
    with registered_platform(tmp_path_factory, tmp_path / "platform") as brought:
        with brought.platform.database.transaction() as session:
            session.scalars(select(CalibrationRow)).one().valid_to_ns = 1
        yield brought


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
    run_all(brought.platform, wrap=lost_once(CHECK))
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


def overlays(brought: Brought) -> dict[tuple[str, str], str]:
    """Return each picture's SHA-256 by recipe and name."""
    with brought.platform.database.reading() as session:
        rows = session.scalars(select(Preview).where(Preview.recording_id.is_(None)))
        return {(row.recipe, row.name): row.blob_sha256 for row in rows}


@pytest.mark.whole
def test_every_camera_has_its_overlay_a_killed_attempt_leaves_the_same_and_they_go_with_their_sequence(
    tmp_path_factory: pytest.TempPathFactory, tmp_path: Path
) -> None:
    """Catches alone overlays of another recipe, or none after a killed attempt."""
    with labelled_platform(tmp_path_factory, tmp_path / "platform") as brought:
        (run,), kept, store = brought.label_sets(), overlays(brought), brought.platform.store
        assert {of for of, _name in kept} == {brought.job(run.job_id).arguments["recipe"]}
        assert len(kept) == 6
        with brought.platform.database.transaction() as session:
            for sha256 in kept.values():
                picture = Image.open(BytesIO(b"".join(store.read(session.get_one(Blob, sha256).object_key))))
                assert picture.format == "JPEG"
            session.execute(delete(Preview).where(Preview.recording_id.is_(None)))
        again = brought.process(stages=("synchronise",))
        run_all(brought.platform, wrap=lost_once(CHECK))
        assert (brought.job(again).state, brought.job(again).failure) == ("succeeded", "")
        assert {(brought.job(again).arguments["recipe"], name): sha256 for (_of, name), sha256 in kept.items()} == (
            overlays(brought)
        )
        with brought.platform.database.transaction() as session:
            delete_sequence(session, brought.sequence())
        assert overlays(brought) == {}
