"""What `eval` does in the queue, stage by stage; counting and scores are those that `pipeline.score` calls.

    open → part (each range of frames) → join (each evaluation version); truth; compare

**Conventions.** A stage may run twice, at once or after being killed anywhere: what it writes is one row each time, in
the transaction of its success. A submission that is refused is no failed job: the job succeeds, the submission has
ended. Neither result nor log line nor failure tells anything of a ground truth.
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
    """The stages by kind."""
    stages: dict[str, Stage] = {
        OPEN: partial(settling, open_submission),
        PART: partial(settling, count_part),
        JOIN: partial(settling, join),
        TRUTH: build_truth,
        COMPARE: compare_label_sets,
    }
    return {kind: partial(_with_context, platform, stage) for kind, stage in stages.items()}


def open_submission(context: EvalStageContext) -> Outcome:
    """The file is kept and its directory checked; what has one part's worth of frames is looked at at once.

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
    is_small = len(following) == 1  # the join alone: it would count all of it
    found = context.examined(case, (0, case.truth.frames if is_small else 0))
    if is_small:
        return concluded(context, case, evaluation_version, found)
    if not found.validation.ok:
        return refuse(context, case, found.validation)
    return Outcome({"state": case.state}, then=following)


def count_part(context: EvalStageContext) -> Outcome:
    """The counts of a range of frames, kept until the join. Raises as `open_submission`, and `submission_purged`."""
    truth_id, start, stop = (context.attempt.arguments[name] for name in ("truth_id", "start", "stop"))
    case = context.case(truth_id)
    if case.is_over or case.kept is not None:
        return Outcome({"state": case.state})
    found = context.examined(case, (start, stop))
    counts = found.counts.packed() if found.counts else b""
    part = CountedPart(
        case.submission_id, truth_id, start, stop, counts, found.validation.as_record(), code_version("scores")
    )

    def write(session: Session) -> None:
        mark_scoring(session, case.submission_id)
        write_part(session, part)

    return Outcome({"frames": stop - start}, commit=write)


def _with_context(platform: Platform, stage: Stage, attempt: Attempt) -> Outcome:
    return stage(EvalStageContext(platform, attempt))


# Moves the file of a submission from its upload to the object store.
#
# **Conventions.** It is kept under its own transaction, not with the job's success: the file that came in can then go,
# and an attempt that is killed afterwards finds it kept.


def keep_file(platform: Platform, submission: SubmissionRow) -> None:
    """Have the file as a blob, and the submission in scoring; nothing happens where that is so.

    Raises `upload_damaged`, `JobCancelledError` where it ended meanwhile, and what the store raises.
    """
    if submission.blob_sha256 is None:
        _keep(platform, submission)
    elif submission.state == "queued":  # an administrator has it tried again
        with platform.database.transaction() as session:
            mark_scoring(session, submission.id)
    if submission.upload_id:
        remove_bytes(platform, [submission.upload_id])


def _keep(platform: Platform, submission: SubmissionRow) -> None:
    declared = submission.declared_sha256
    with ExitStack() as copies:
        prepared = prepare(platform.store, platform.database, _received(platform, submission, copies), adopt=True)
        if prepared.sha256 != declared:
            raise upload_damaged(prepared.sha256, declared)
        with platform.database.transaction() as session:
            _write(session, submission.id, prepared)


def _received(platform: Platform, submission: SubmissionRow, copies: ExitStack) -> Path:
    """The file on this machine. Raises `upload_damaged` when it is gone."""
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


def upload_damaged(found: str, declared: str) -> Refused:
    what = f"a file with sha256 {found}" if found else "no file"
    return Refused(
        "upload_damaged",
        f"the upload contains {what} instead of the declared {declared}; was the file changed after sending? Send it "
        "again",
    )
