"""Invariants after a round; each violation is reported with its reason.

**Conventions.** Everything is read directly from the database and the store, once the round has ended. A check without
anything to check is a violation too, since it would prove nothing.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from typing import Literal, TypeVar

from sqlalchemy import select
from sqlalchemy.orm import Session

from chaos.result_hashes import OwnerRun, RunArtefacts, made_by, object_bytes
from services.runtime.access import storage_quota
from services.runtime.orm import (
    Artefact,
    Blob,
    Export,
    ExportPack,
    Job,
    JobAttempt,
    LabelSet,
    Preview,
    Recording,
    SequenceRow,
    Upload,
)
from services.runtime.platform import Platform
from services.runtime.uploads.files import upload_file
from services.runtime.uploads.part_rows import upload_parts_of

Sort = Literal["lost", "doubled", "differing"]
Name = TypeVar("Name", str, tuple[int, str])


@dataclass(frozen=True)
class Violation:
    """A violated invariant."""

    sort: Sort
    sentence: str


def judge(platform: Platform, brought: OwnerRun, undisturbed: RunArtefacts) -> list[Violation]:
    """Return every violation of a finished round."""
    with platform.database.reading() as session:
        violations = [
            *_judge_jobs(session, brought, platform.settings.jobs.max_attempts),
            *_judge_label_sets(session, brought),
            *_judge_recordings(session, brought),
            *_judge_quota(session, brought),
        ]
    violations += _judge_uploads(platform, brought)
    violations += _judge_made(made_by(platform, brought), undisturbed)
    return violations + list(judge_blobs(platform))


def judge_blobs(platform: Platform) -> Iterator[Violation]:
    """Yield blobs without an object, and objects that differ from their row."""
    with platform.database.reading() as session:
        blobs = session.scalars(select(Blob)).all()
    for blob in blobs:
        content = object_bytes(platform.store, blob.object_key)
        if content is None:
            yield Violation("lost", f"blob {blob.sha256} has no object {blob.object_key}")
        elif sha256(content).hexdigest() != blob.sha256:
            yield Violation("differing", f"object {blob.object_key} differs from its row")


def _judge_jobs(session: Session, brought: OwnerRun, max_attempts: int) -> Iterator[Violation]:
    """Yield a violation unless every job succeeded once within its attempts, and all others were lost to kills."""
    judged = (Job.owner_id == brought.owner_id, Job.root_id != brought.replaced_id)
    jobs = session.scalars(select(Job).where(*judged)).all()
    if not any(job.id == brought.run_id for job in jobs):
        yield Violation("lost", f"there is no run {brought.run_id}")
    for job in jobs:
        if job.state != "succeeded":
            yield Violation("lost", f"{job.kind} {job.id} is {job.state}: {job.failure or 'no reason given'}")
        if job.queue:
            attempts = select(JobAttempt).where(JobAttempt.job_id == job.id).order_by(JobAttempt.number)
            yield from _judge_attempts(job, session.scalars(attempts).all(), max_attempts)


def _judge_attempts(job: Job, attempts: Sequence[JobAttempt], max_attempts: int) -> Iterator[Violation]:
    name = f"{job.kind} {job.id}"
    outcomes = Counter(attempt.outcome for attempt in attempts)
    succeeded, others = outcomes.pop("succeeded", 0), sorted(outcomes)
    if succeeded > 1:
        yield Violation("doubled", f"{name} was done {succeeded} times")
    if succeeded == 0:
        yield Violation("lost", f"{name} never succeeded: {len(attempts)} attempts")
    if len(attempts) > max_attempts:
        yield Violation("doubled", f"{name} was tried {len(attempts)} times, {max_attempts} are allowed")
    if [attempt.number for attempt in attempts] != list(range(1, job.attempt + 1)):
        yield Violation("lost", f"{name} had {job.attempt} attempts, but has rows of {len(attempts)}")
    if others not in ([], ["lost"]):
        yield Violation("lost", f"{name} has attempts that ended {others}; a kill can only make them lost")


def _judge_label_sets(session: Session, brought: OwnerRun) -> Iterator[Violation]:
    """Yield a violation unless the run made exactly one label set."""
    made_by_run = session.scalars(select(LabelSet.job_id).where(LabelSet.sequence_id == brought.sequence_id)).all()
    if not made_by_run:
        yield Violation("lost", f"sequence {brought.sequence_id} has no label set")
    if len(made_by_run) > 1 or any(job_id != brought.run_id for job_id in made_by_run):
        yield Violation("doubled", f"sequence {brought.sequence_id} has label sets of the runs {sorted(made_by_run)}")


def _judge_recordings(session: Session, brought: OwnerRun) -> Iterator[Violation]:
    """Yield a violation unless there is one registered recording with the uploaded bytes."""
    recordings = session.scalars(select(Recording).where(Recording.sequence_id == brought.sequence_id)).all()
    if not recordings:
        yield Violation("lost", f"sequence {brought.sequence_id} has no recording")
    if len(recordings) > 1:
        yield Violation("doubled", f"sequence {brought.sequence_id} has {len(recordings)} recordings")
    for recording in recordings:
        if recording.state != "registered":
            yield Violation("lost", f"recording {recording.id} is {recording.state}")
        kept = [file.blob_sha256 for file in recording.files]
        if recording.sha256 != brought.sha256 or kept != [brought.sha256]:
            yield Violation("differing", f"recording {recording.id} is kept as {kept}, not as {brought.sha256}")


def _judge_quota(session: Session, brought: OwnerRun) -> Iterator[Violation]:
    """Yield a violation unless the quota counts each unfinished or stored upload, and each file made of it, once."""
    counted = storage_quota.balance(session, brought.owner_id)
    held = held_bytes(session, brought.owner_id)
    if counted != held:
        sort: Sort = "doubled" if counted > held else "lost"
        yield Violation(sort, f"{counted} bytes are counted, the rows contain {held} bytes")


def held_bytes(session: Session, owner_id: str) -> int:
    """Return the bytes of an owner's uploads, label sets, previews and exports, by their rows.

    Bags in place, comparisons and imported datasets do not count.
    """
    mine = SequenceRow.owner_id == owner_id
    uploads = select(Upload.length_bytes).where(
        Upload.owner_id == owner_id, Upload.state.in_(("open", "complete", "consumed"))
    )
    artefacts = select(Artefact.size_bytes).join(LabelSet).join(SequenceRow).where(mine)
    previews = select(Preview.size_bytes).join(SequenceRow).where(mine)
    exports = select(ExportPack.size_bytes).join(Export).join(SequenceRow).where(mine)
    indices = select(Blob.size_bytes).join(Export, Export.index_sha256 == Blob.sha256).join(SequenceRow).where(mine)
    return sum(sum(session.scalars(sizes)) for sizes in (uploads, artefacts, previews, exports, indices))


def _judge_uploads(platform: Platform, brought: OwnerRun) -> Iterator[Violation]:
    """Yield a violation unless one upload is used and whole; an upload that a killed client forgot has no bytes."""
    with platform.database.reading() as session:
        uploads = session.scalars(select(Upload).where(Upload.owner_id == brought.owner_id)).all()
    states = [upload.state for upload in uploads]
    if "consumed" not in states:
        yield Violation("lost", f"no upload arrived: {states}")
    for upload in uploads:
        content = _content(platform, upload)
        if upload.state == "open" and not content:
            continue
        if upload.state != "consumed":
            yield Violation("doubled", f"upload {upload.id} is {upload.state} beside the used upload: {states}")
        elif upload.sha256 != brought.sha256:
            yield Violation(
                "differing", f"upload {upload.id} has the sha256 {upload.sha256}, but {brought.sha256} was sent"
            )
        elif content is not None and sha256(content).hexdigest() != brought.sha256:
            yield Violation("differing", f"the stored bytes of upload {upload.id} differ from the sent bytes")


def _content(platform: Platform, upload: Upload) -> bytes | None:
    """Return the upload's bytes in the folder or in the store; None if it is gone."""
    if upload.backend == "folder":
        path = upload_file(platform.settings, upload.id)
        return path.read_bytes() if path.exists() else None
    with platform.database.reading() as session:
        upload_parts = upload_parts_of(session, upload.id)
    return b"".join(object_bytes(platform.store, part.key) or b"" for part in upload_parts) if upload_parts else None


def _judge_made(made: RunArtefacts, undisturbed: RunArtefacts) -> Iterator[Violation]:
    """Yield a violation unless artefacts, frames and numbers of jobs equal those of the undisturbed run."""
    if not undisturbed.artefacts or not undisturbed.frames:
        yield Violation("lost", "the undisturbed run produced no results to compare with")
    yield from (Violation("differing", flaw) for flaw in made.flaws)
    yield from _judge_same("artefact", made.artefacts, undisturbed.artefacts)
    yield from _judge_same("frame", made.frames, undisturbed.frames)
    for kind in sorted({*made.jobs, *undisturbed.jobs}):
        count, expected = made.jobs.get(kind, 0), undisturbed.jobs.get(kind, 0)
        if count != expected:
            yield Violation("doubled" if count > expected else "lost", f"{count} jobs {kind}, undisturbed {expected}")


def _judge_same(noun: str, made: Mapping[Name, str], expected: Mapping[Name, str]) -> Iterator[Violation]:
    for name in sorted(expected.keys() - made.keys(), key=str):
        yield Violation("lost", f"{noun} {name} is missing")
    for name in sorted(made.keys() - expected.keys(), key=str):
        yield Violation("differing", f"{noun} {name} is missing from the undisturbed run")
    for name in sorted(made.keys() & expected.keys(), key=str):
        if made[name] != expected[name]:
            yield Violation("differing", f"{noun} {name} is {made[name]}, undisturbed {expected[name]}")
