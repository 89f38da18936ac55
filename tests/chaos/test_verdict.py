"""The verdict finds what it is there to find: each planted violation, and nothing where there is none."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from sqlalchemy import Update, delete, select, update
from sqlalchemy.orm import Session

from chaos.result_hashes import RunArtefacts, made_by
from chaos.verdict import Violation, judge
from services.runtime.orm import (
    Artefact,
    Blob,
    Job,
    JobAttempt,
    LabelledFrameRow,
    LabelSet,
    QuotaEntry,
    Recording,
    RecordingFile,
    SequenceRow,
    Upload,
)
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.store.folder import FolderStore
from services.runtime.uploads.files import upload_file
from tests.chaos.played import Played, a_job, play_well

Spoil = Callable[[Session], object]


@pytest.fixture
def played(platform: Platform, tmp_path: Path) -> Played:
    return play_well(platform, tmp_path)


def judged(played: Played, undisturbed: RunArtefacts | None = None) -> list[Violation]:
    return judge(played.platform, played.brought, undisturbed or played.made)


def sorts_after(played: Played, spoil: Spoil | Update) -> set[str]:
    """What the verdict says once the rows have been spoilt."""
    with played.platform.database.transaction() as session:
        if isinstance(spoil, Update):
            session.execute(spoil)
        else:
            spoil(session)
    found = judged(played)
    assert all(violation.sentence for violation in found)
    return {violation.sort for violation in found}


def object_of(played: Played, sha256: str) -> Path:
    with played.platform.database.reading() as session:
        key = session.get_one(Blob, sha256).object_key
    assert isinstance(played.platform.store, FolderStore)
    return played.platform.store.root / key


def spoil_object(path: Path) -> None:
    path.chmod(0o600)
    path.write_bytes(b"x" + path.read_bytes()[1:])


def test_a_round_that_went_well_has_no_violation(played: Played) -> None:
    assert judged(played) == []
    assert (len(played.made.artefacts), len(played.made.frames), sum(played.made.jobs.values())) == (2, 2, 4)


@pytest.mark.parametrize("state", ["queued", "running", "failed", "cancelled"])
def test_a_job_that_has_not_succeeded_is_lost(played: Played, state: str) -> None:
    assert sorts_after(played, update(Job).where(Job.kind == "labeler.fuse").values(state=state)) == {"lost"}


def test_a_run_that_is_not_there_is_lost(played: Played) -> None:
    found = judge(played.platform, replace(played.brought, run_id="0" * 32), played.made)
    assert "there is no run" in found[0].sentence


def test_a_job_that_two_attempts_have_done_is_doubled(played: Played) -> None:
    assert sorts_after(played, update(JobAttempt).values(outcome="succeeded")) == {"doubled"}


def test_a_job_that_no_attempt_has_done_is_lost(played: Played) -> None:
    assert sorts_after(played, update(JobAttempt).values(outcome="lost")) == {"lost"}


@pytest.mark.parametrize("outcome", ["", "failed", "cancelled"])
def test_an_attempt_that_is_open_or_ended_by_anything_but_a_kill_is_told(played: Played, outcome: str) -> None:
    assert sorts_after(played, update(JobAttempt).where(JobAttempt.outcome == "lost").values(outcome=outcome)) == {
        "lost"
    }


def test_more_attempts_than_allowed_are_doubled_work(played: Played) -> None:
    def try_again(session: Session) -> None:
        job = session.scalars(select(Job).where(Job.kind == "labeler.fuse")).one()
        session.add_all([JobAttempt(job_id=job.id, number=number, worker="", outcome="lost") for number in (3, 4)])
        job.attempt = 4

    assert sorts_after(played, try_again) == {"doubled"}


def test_an_attempt_that_left_no_trace_is_lost(played: Played) -> None:
    assert sorts_after(played, update(Job).where(Job.kind == "labeler.fuse").values(attempt=3)) == {"lost"}


def test_a_job_more_than_undisturbed_is_doubled(played: Played) -> None:
    def fan_out_twice(session: Session) -> None:
        run = session.get_one(Job, played.brought.run_id)
        a_job(session, session.get_one(SequenceRow, played.brought.sequence_id), "labeler.fuse", ("succeeded",), run)

    assert sorts_after(played, fan_out_twice) == {"doubled"}


def test_a_label_set_of_another_run_is_doubled(played: Played) -> None:
    def publish_twice(session: Session) -> None:
        other = session.scalars(select(Job).where(Job.kind == "labeler.publish")).one()
        duplicate = LabelSet(
            sequence_id=played.brought.sequence_id, job_id=other.id, recipe="s", parameters={}, frames=0
        )
        duplicate.code_version = "1"
        session.add(duplicate)

    assert sorts_after(played, publish_twice) == {"doubled"}


def test_no_label_set_is_lost(played: Played) -> None:
    assert sorts_after(played, lambda session: session.execute(delete(LabelSet))) == {"lost"}


def test_an_artefact_that_is_missing_is_lost(played: Played) -> None:
    report = delete(Artefact).where(Artefact.name == "report.json")
    assert sorts_after(played, lambda session: session.execute(report)) == {"lost"}


def test_an_artefact_of_other_bytes_differs(played: Played) -> None:
    other = replace(played.made, artefacts={**played.made.artefacts, "report.json": "0" * 64})
    assert {violation.sort for violation in judged(played, other)} == {"differing"}


def test_an_artefact_that_should_not_be_differs(played: Played) -> None:
    assert sorts_after(played, update(Artefact).where(Artefact.name == "report.json").values(name="r.json")) == {
        "differing",
        "lost",
    }


def test_a_frame_of_other_bytes_differs(played: Played) -> None:
    moved = (
        update(LabelledFrameRow)
        .where(LabelledFrameRow.ordinal == 1)
        .values(offset_bytes=LabelledFrameRow.offset_bytes - 1)
    )
    assert sorts_after(played, moved) == {"differing"}


def test_a_frame_that_is_missing_is_lost(played: Played) -> None:
    last = delete(LabelledFrameRow).where(LabelledFrameRow.ordinal == 1)
    assert sorts_after(played, lambda session: session.execute(last)) == {"lost"}


def test_an_object_that_was_changed_in_the_store_differs(played: Played) -> None:
    with played.platform.database.reading() as session:
        pack = session.scalars(select(Artefact).where(Artefact.name == "labels/000000.pack")).one()
    spoil_object(object_of(played, pack.blob_sha256))
    assert {violation.sort for violation in judged(played)} == {"differing"}


def test_a_blob_without_its_object_is_lost(played: Played) -> None:
    object_of(played, played.brought.sha256).unlink()
    assert [violation.sort for violation in judged(played)] == ["lost"]


def test_two_recordings_are_doubled(played: Played) -> None:
    def register_twice(session: Session) -> None:
        duplicate = Recording(
            sequence_id=played.brought.sequence_id, filename="chaos.mcap", size_bytes=1, state="registered"
        )
        duplicate.sha256 = sha256 = played.brought.sha256
        duplicate.files = [
            RecordingFile(ordinal=0, filename="chaos.mcap", size_bytes=1, sha256=sha256, blob_sha256=sha256)
        ]
        session.add(duplicate)

    assert sorts_after(played, register_twice) == {"doubled"}


def test_no_recording_is_lost(played: Played) -> None:
    assert sorts_after(played, lambda session: session.execute(delete(Recording))) == {"lost"}


def test_a_recording_that_was_not_read_is_lost(played: Played) -> None:
    assert sorts_after(played, update(Recording).values(state="received")) == {"lost"}


def test_a_recording_of_other_bytes_differs(played: Played) -> None:
    assert sorts_after(played, update(Recording).values(sha256="0" * 64)) == {"differing"}


def test_an_upload_of_other_bytes_differs(played: Played) -> None:
    assert sorts_after(played, update(Upload).values(sha256="0" * 64)) == {"differing"}


def test_an_upload_that_is_something_else_on_disk_differs(played: Played) -> None:
    with played.platform.database.reading() as session:
        upload_id = session.scalars(select(Upload.id)).one()
    spoil_object(upload_file(played.platform.settings, upload_id))
    assert {violation.sort for violation in judged(played)} == {"differing"}


@pytest.mark.parametrize("state", ["open", "complete", "failed"])
def test_an_upload_that_was_not_used_is_lost(played: Played, state: str) -> None:
    assert "lost" in sorts_after(played, update(Upload).values(state=state))


@pytest.mark.parametrize(("content", "sorts"), [(b"", set[str]()), (b"half", {"doubled"})])
def test_a_forgotten_upload_is_harmless_only_while_nothing_was_sent(
    played: Played, content: bytes, sorts: set[str]
) -> None:
    def begin_another(session: Session) -> None:
        owner_id = played.brought.owner_id
        duplicate = Upload(owner_id=owner_id, purpose="recording", filename="chaos.mcap", length_bytes=9, state="open")
        duplicate.id, duplicate.expires_ns = "f" * 32, now_ns()
        session.add_all(
            [duplicate, QuotaEntry(owner_id=owner_id, kind="bytes", amount=9, subject_id=duplicate.id, reason="")]
        )
        upload_file(played.platform.settings, duplicate.id).write_bytes(content)

    assert sorts_after(played, begin_another) == sorts


@pytest.mark.parametrize(("amount", "sort"), [(1, "doubled"), (-1, "lost")])
def test_bytes_that_are_counted_wrongly_are_told(played: Played, amount: int, sort: str) -> None:
    entry = QuotaEntry(owner_id=played.brought.owner_id, kind="bytes", amount=amount, subject_id="x", reason="")
    assert sorts_after(played, lambda session: session.add(entry)) == {sort}


def test_nothing_to_compare_with_proves_nothing(played: Played) -> None:
    assert any("nothing to compare with" in violation.sentence for violation in judged(played, RunArtefacts()))


def test_hashes_are_taken_of_what_lies_in_the_store(played: Played) -> None:
    with played.platform.database.transaction() as session:
        session.execute(update(LabelledFrameRow).values(sha256="0" * 64))
    made = made_by(played.platform, played.brought)
    assert (made.frames, len(made.flaws)) == (played.made.frames, 2)
