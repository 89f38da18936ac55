"""The verdict finds what it is there to find: each planted violation, and nothing where there is none."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

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

Act = Callable[[Session, Played], object]


@pytest.fixture
def played(platform: Platform, tmp_path: Path) -> Played:
    return play_well(platform, tmp_path)


def judged(played: Played, undisturbed: RunArtefacts | None = None) -> list[Violation]:
    return judge(played.platform, played.brought, undisturbed or played.made)


def sorts_after(played: Played, act: Act | Update | Any) -> set[str]:
    """What the verdict says once the rows have been spoilt."""
    with played.platform.database.transaction() as session:
        if callable(act):
            act(session, played)
        else:
            session.execute(act)
    return {violation.sort for violation in judged(played)}


def spoil_object(path: Path) -> None:
    path.chmod(0o600)
    path.write_bytes(b"x" + path.read_bytes()[1:])


def object_of(played: Played, sha256: str) -> Path:
    with played.platform.database.reading() as session:
        key = session.get_one(Blob, sha256).object_key
    assert isinstance(played.platform.store, FolderStore)
    return played.platform.store.root / key


def try_too_often(session: Session, played: Played) -> None:
    job = session.scalars(select(Job).where(Job.kind == "labeler.fuse")).one()
    session.add_all([JobAttempt(job_id=job.id, number=number, worker="", outcome="lost") for number in (3, 4)])
    job.attempt = 4


def fan_out_twice(session: Session, played: Played) -> None:
    run = session.get_one(Job, played.brought.run_id)
    a_job(session, session.get_one(SequenceRow, played.brought.sequence_id), "labeler.fuse", ("succeeded",), run)


def publish_twice(session: Session, played: Played) -> None:
    other = session.scalars(select(Job).where(Job.kind == "labeler.publish")).one()
    made = LabelSet(sequence_id=played.brought.sequence_id, job_id=other.id, recipe="s", parameters={}, frames=0)
    made.code_version = "1"
    session.add(made)


def register_twice(session: Session, played: Played) -> None:
    sha256 = played.brought.sha256
    made = Recording(sequence_id=played.brought.sequence_id, filename="chaos.mcap", size_bytes=1, state="registered")
    made.sha256 = sha256
    made.files = [RecordingFile(ordinal=0, filename="chaos.mcap", size_bytes=1, sha256=sha256, blob_sha256=sha256)]
    session.add(made)


def begin_another(content: bytes) -> Act:
    """An upload that was begun and forgotten, with so much of it on disk."""

    def begin(session: Session, played: Played) -> None:
        owner_id = played.brought.owner_id
        made = Upload(owner_id=owner_id, purpose="recording", filename="chaos.mcap", length_bytes=9, state="open")
        made.id, made.expires_ns = "f" * 32, now_ns()
        session.add_all([made, QuotaEntry(owner_id=owner_id, kind="bytes", amount=9, subject_id=made.id, reason="")])
        upload_file(played.platform.settings, made.id).write_bytes(content)

    return begin


def counted(amount: int) -> Act:
    def count(session: Session, played: Played) -> None:
        owner_id = played.brought.owner_id
        session.add(QuotaEntry(owner_id=owner_id, kind="bytes", amount=amount, subject_id="x", reason=""))

    return count


def fused(**columns: Any) -> Update:
    return update(Job).where(Job.kind == "labeler.fuse").values(**columns)


def outcome(word: str) -> Update:
    return update(JobAttempt).where(JobAttempt.outcome == "lost").values(outcome=word)


REPORT, LAST = Artefact.name == "report.json", LabelledFrameRow.ordinal == 1
SPOILT: dict[str, tuple[Any, set[str]]] = {
    **{f"a job that is {state}": (fused(state=state), {"lost"}) for state in ("queued", "running", "failed")},
    "a job done by two attempts": (update(JobAttempt).values(outcome="succeeded"), {"doubled"}),
    "a job done by none": (update(JobAttempt).values(outcome="lost"), {"lost"}),
    **{f"an attempt that ended as {word or 'open'}": (outcome(word), {"lost"}) for word in ("", "failed", "cancelled")},
    "more attempts than allowed": (try_too_often, {"doubled"}),
    "an attempt without a trace": (fused(attempt=3), {"lost"}),
    "a job more than undisturbed": (fan_out_twice, {"doubled"}),
    "a label set of another run": (publish_twice, {"doubled"}),
    "no label set": (delete(LabelSet), {"lost", "doubled"}),
    "an artefact that is missing": (delete(Artefact).where(REPORT), {"lost", "doubled"}),
    "another artefact": (update(Artefact).where(REPORT).values(name="r.json"), {"differing", "lost"}),
    "a frame of other bytes": (
        update(LabelledFrameRow).where(LAST).values(offset_bytes=LabelledFrameRow.offset_bytes - 1),
        {"differing"},
    ),
    "a frame that is missing": (delete(LabelledFrameRow).where(LAST), {"lost"}),
    "two recordings": (register_twice, {"doubled"}),
    "no recording": (delete(Recording), {"lost"}),
    "a recording that was not read": (update(Recording).values(state="received"), {"lost"}),
    "a recording of other bytes": (update(Recording).values(sha256="0" * 64), {"differing"}),
    "an upload of other bytes": (update(Upload).values(sha256="0" * 64), {"differing"}),
    "an upload that failed": (update(Upload).values(state="failed"), {"lost", "doubled"}),
    "a forgotten upload without bytes": (begin_another(b""), set()),
    "a forgotten upload with bytes": (begin_another(b"half"), {"doubled"}),
    "bytes counted twice": (counted(1), {"doubled"}),
    "bytes not counted": (counted(-1), {"lost"}),
}


def test_a_round_that_went_well_has_no_violation(played: Played) -> None:
    assert judged(played) == []
    assert (len(played.made.artefacts), len(played.made.frames), sum(played.made.jobs.values())) == (2, 2, 4)


@pytest.mark.parametrize("case", SPOILT)
def test_what_is_lost_doubled_or_different_is_told(played: Played, case: str) -> None:
    act, sorts = SPOILT[case]
    assert sorts_after(played, act) == sorts


def test_objects_and_files_that_changed_or_went_are_told(played: Played) -> None:
    with played.platform.database.reading() as session:
        pack = session.scalars(select(Artefact).where(Artefact.name == "labels/000000.pack")).one()
        upload_id = session.scalars(select(Upload.id)).one()
    spoil_object(upload_file(played.platform.settings, upload_id))
    assert {violation.sort for violation in judged(played)} == {"differing"}
    spoil_object(object_of(played, pack.blob_sha256))
    assert {violation.sort for violation in judged(played)} == {"differing"}
    object_of(played, played.brought.sha256).unlink()
    assert {violation.sort for violation in judged(played)} == {"differing", "lost"}


def test_a_run_is_judged_by_the_hashes_of_an_undisturbed_one(played: Played) -> None:
    other = replace(played.made, artefacts={**played.made.artefacts, "report.json": "0" * 64})
    assert {violation.sort for violation in judged(played, other)} == {"differing"}
    assert judged(played, RunArtefacts()) != [], "nothing to compare with proves nothing"
    assert judge(played.platform, replace(played.brought, run_id="0" * 32), played.made) != []
    with played.platform.database.transaction() as session:
        session.execute(update(LabelledFrameRow).values(sha256="0" * 64))
    made = made_by(played.platform, played.brought)
    assert (made.frames, len(made.flaws)) == (played.made.frames, 2)
