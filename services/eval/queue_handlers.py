"""The stages of `eval` in the queue; they count and score with the functions of `pipeline.score`.

    open → part (each range of frames) → join (each evaluation version); truth; compare

**Conventions.** A stage may run twice, concurrently or after being killed anywhere: it writes a row only in the
transaction of its success. A refused submission is not a failed job: the job succeeds and the submission has ended.
Results, log lines and failures reveal nothing about a ground truth.
"""

from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path

from sqlalchemy import update
from sqlalchemy.orm import Session

from services.domain.benchmarks.phases.evaluation_versions import active
from services.domain.benchmarks.submissions.score_rows import CountedPart, write_part
from services.domain.benchmarks.submissions.scoring_jobs import JOIN, OPEN, PART, TRUTH, scoring_specs
from services.domain.benchmarks.submissions.submissions import mark_scoring
from services.domain.sequences.label_comparisons import COMPARE
from services.eval.comparison.stage import compare_label_sets
from services.eval.join import Stage, concluded, join, refuse, settling
from services.eval.scored_case import live_submission
from services.eval.scoring_errors import truth_unready
from services.eval.scoring_workspace import EvalStageContext
from services.eval.truth_build import build_truth
from services.runtime.code_version import code_version
from services.runtime.jobs.specs import Attempt, Handlers, Outcome
from services.runtime.orm import SubmissionRow, Upload
from services.runtime.platform import Platform
from services.runtime.store.blobs import PreparedBlob, link, prepare
from services.runtime.store.keys import ObjectMissingError
from services.runtime.uploads.backends import backend_of, remove_bytes
from stone.errors import Refused


def handlers(platform: Platform) -> Handlers:
    """Return the stages by kind."""
    stages: dict[str, Stage] = {
        OPEN: partial(settling, open_submission),
        PART: partial(settling, count_part),
        JOIN: partial(settling, join),
        TRUTH: build_truth,
        COMPARE: compare_label_sets,
    }
    return {kind: partial(_with_context, platform, stage) for kind, stage in stages.items()}


def open_submission(context: EvalStageContext) -> Outcome:
    """Store the file and check its directory; a submission with a single part is examined immediately.

    Raises `JobCancelledError`, `upload_damaged`, `ground_truth_unready`, `scoring_crashed`.
    """
    with context.platform.database.reading() as session:
        submission = live_submission(session, context.submission_id)
        evaluation_version = active(session, submission.phase_id)
    context.attempt.progress("keep", 0, 1)
    keep_file(context.platform, submission)
    if evaluation_version is None:
        raise truth_unready(f"phase {submission.phase_id}")
    case = context.case(evaluation_version.truth_id)
    if not case.is_under_way:
        return Outcome({"state": case.state})
    following = scoring_specs(case.submission_id, evaluation_version, case.truth.frames)
    is_small = len(following) == 1  # only the join, which would count all frames
    examined = context.examined(case, (0, case.truth.frames if is_small else 0))
    if is_small:
        return concluded(context, case, evaluation_version, examined)
    if not examined.validation.ok:
        return refuse(context, case, examined.validation)
    return Outcome({"state": case.state}, then=following)


def count_part(context: EvalStageContext) -> Outcome:
    """Count a range of frames and store the counts until the join. Raises as `open_submission`, `submission_purged`."""
    truth_id, start, stop = (context.attempt.arguments[name] for name in ("truth_id", "start", "stop"))
    case = context.case(truth_id)
    if case.is_over or case.kept is not None:
        return Outcome({"state": case.state})
    examined = context.examined(case, (start, stop))
    counts = examined.counts.packed() if examined.counts else b""
    part = CountedPart(
        case.submission_id, truth_id, start, stop, counts, examined.validation.as_record(), code_version("scores")
    )

    def write(session: Session) -> None:
        mark_scoring(session, case.submission_id)
        write_part(session, part)

    return Outcome({"frames": stop - start}, commit=write)


def _with_context(platform: Platform, stage: Stage, attempt: Attempt) -> Outcome:
    return stage(EvalStageContext(platform, attempt))


# Moves the file of a submission from its upload to the object store. It is stored in a separate transaction, not with
# the job's success, so that the upload can be deleted and a later attempt finds the file.


def keep_file(platform: Platform, submission: SubmissionRow) -> None:
    """Store the file as a blob and mark the submission as being scored, unless this is already done.

    Raises `upload_damaged`, `JobCancelledError` if the submission ended meanwhile, and what the store raises.
    """
    if submission.blob_sha256 is None:
        _keep(platform, submission)
    elif submission.state == "queued":  # retried by an administrator
        with platform.database.transaction() as session:
            mark_scoring(session, submission.id)
    if submission.upload_id:
        remove_bytes(platform, [submission.upload_id])


def _keep(platform: Platform, submission: SubmissionRow) -> None:
    declared = submission.declared_sha256
    with ExitStack() as copies:
        prepared = prepare(platform.store, platform.database, _locate_upload(platform, submission, copies), adopt=True)
        if prepared.sha256 != declared:
            raise upload_damaged(prepared.sha256, declared)
        with platform.database.transaction() as session:
            _write(session, submission.id, prepared)


def _locate_upload(platform: Platform, submission: SubmissionRow, copies: ExitStack) -> Path:
    """Return the path of the uploaded file on this machine. Raises `upload_damaged` if it does not exist."""
    with platform.database.reading() as session:
        upload = session.get(Upload, submission.upload_id or "")
    if upload is not None:
        with suppress(FileNotFoundError, ObjectMissingError):
            return copies.enter_context(backend_of(platform, upload).local(upload))
    raise upload_damaged("", submission.declared_sha256)


def _write(session: Session, submission_id: str, prepared: PreparedBlob) -> None:
    mark_scoring(session, submission_id)
    blob = link(session, prepared)
    unkept = update(SubmissionRow).where(SubmissionRow.id == submission_id, SubmissionRow.blob_sha256.is_(None))
    session.execute(unkept.values(blob_sha256=blob.sha256), execution_options={"synchronize_session": False})


def upload_damaged(actual: str, declared: str) -> Refused:
    what = f"a file with sha256 {actual}" if actual else "no file"
    return Refused(
        "upload_damaged",
        f"the upload has {what}, but {declared} was declared; was the file changed after sending? Send it again",
    )
