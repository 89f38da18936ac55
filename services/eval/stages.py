"""What `eval` does in the queue, stage by stage; counting and scores are those that `pipeline.score` calls.

    open → part (each range of frames) → join (each pair); truth

**Conventions.** A stage may run twice, at once or after being killed anywhere: what it writes is one row each time, in
the transaction of its success. A submission that is refused is no failed job: the job succeeds, the submission has
ended. Neither result nor log line nor failure tells anything of a ground truth.
"""

from functools import partial

from sqlalchemy.orm import Session

from services.eval.cases import standing_submission
from services.eval.desk import Desk
from services.eval.joining import concluded, join
from services.eval.keeping import keep_file
from services.eval.scoring_errors import TruthUnreadyError
from services.eval.settling import Stage, refuse, settling
from services.eval.truth_building import build_truth
from services.runtime.benchmarks.pairs import active
from services.runtime.benchmarks.scores import CountedPart, write_part
from services.runtime.benchmarks.scoring_jobs import JOIN, OPEN, PART, TRUTH, scoring_specs
from services.runtime.benchmarks.submissions import mark_scoring
from services.runtime.jobs.specs import Attempt, Handlers, Outcome
from services.runtime.platform import Platform


def handlers(platform: Platform) -> Handlers:
    """The stages by kind."""
    stages: dict[str, Stage] = {
        OPEN: partial(settling, open_submission),
        PART: partial(settling, count_part),
        JOIN: partial(settling, join),
        TRUTH: build_truth,
    }
    return {kind: partial(_at_a_desk, platform, stage) for kind, stage in stages.items()}


def open_submission(desk: Desk) -> Outcome:
    """The file is kept and its directory checked; what has one part's worth of frames is looked at at once.

    Raises `JobCancelledError`, `UploadDamagedError`, `TruthUnreadyError`, `ScoringCrashedError`.
    """
    with desk.platform.database.reading() as session:
        submission = standing_submission(session, desk.submission_id)
        pair = active(session, submission.phase_id)
    desk.attempt.progress("keep", 0, 1)
    keep_file(desk.platform, submission)
    if pair is None:
        raise TruthUnreadyError(f"phase {submission.phase_id}")
    case = desk.case(pair.truth_id)
    if not case.is_under_way:
        return Outcome({"state": case.state})
    following = scoring_specs(case.submission_id, pair, case.truth.frames)
    is_small = len(following) == 1  # the join alone: it would count all of it
    found = desk.examined(case, (0, case.truth.frames if is_small else 0))
    if is_small:
        return concluded(desk, case, pair, found)
    if not found.validation.ok:
        return refuse(desk, case, found.validation)
    return Outcome({"state": case.state}, then=following)


def count_part(desk: Desk) -> Outcome:
    """The counts of a range of frames, kept until the join. Raises as `open_submission` does, and `PurgedError`."""
    truth_id, start, stop = (desk.attempt.arguments[name] for name in ("truth_id", "start", "stop"))
    case = desk.case(truth_id)
    if case.is_over or case.confusions_key:
        return Outcome({"state": case.state})
    found = desk.examined(case, (start, stop))
    counts = found.counts.packed() if found.counts else b""
    part = CountedPart(case.submission_id, truth_id, start, stop, counts, found.validation.as_record())

    def write(session: Session) -> None:
        mark_scoring(session, case.submission_id)
        write_part(session, part)

    return Outcome({"frames": stop - start}, commit=write)


def _at_a_desk(platform: Platform, stage: Stage, attempt: Attempt) -> Outcome:
    return stage(Desk(platform, attempt))
