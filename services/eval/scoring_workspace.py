"""The context of an `eval` stage: the platform, the job's attempt, its folder, and sandboxed examination."""

from dataclasses import dataclass
from pathlib import Path

from services.domain.benchmarks.phases.evaluation_versions import EvaluationVersion
from services.domain.benchmarks.submissions.scoring_ranges import Span
from services.eval.examination import Examination, ExaminedRange, examine
from services.eval.scored_case import Case, case_of
from services.runtime.jobs.specs import Attempt
from services.runtime.platform import Platform
from services.runtime.sandbox.job_sandbox import sandbox_watch_of
from services.runtime.store.faults import comparing, refuse_damaged
from services.runtime.store.workspace import Workspace
from services.runtime.telemetry.counters import FRAMES, process_counters


@dataclass(frozen=True, eq=False)
class EvalStageContext:
    """The arguments of every stage."""

    platform: Platform
    attempt: Attempt

    @property
    def submission_id(self) -> str:
        return str(self.attempt.arguments["submission_id"])

    @property
    def evaluation_version(self) -> EvaluationVersion:
        """The evaluation version of a join."""
        return EvaluationVersion(self.attempt.arguments["truth_id"], self.attempt.arguments["metric"])

    @property
    def folder(self) -> Path:
        """The run's folder, which is deleted some time after the run has ended."""
        return Workspace(self.platform.store, self.platform.settings, self.attempt.root_id).folder

    def case(self, truth_id: str) -> Case:
        """Return the current case. Raises `JobCancelledError`, `ground_truth_unready`."""
        with self.platform.database.reading() as session:
            return case_of(session, self.submission_id, truth_id)

    def examined(self, case: Case, span: Span) -> ExaminedRange:
        """Examine the frames [start, stop) of the submission; they are counted unless they are only to be checked.

        Before the file is refused, it is compared with the uploaded file, so that damage in the store is not blamed on
        the submitter. Raises `submission_purged`, `scoring_crashed`, `scoring_interrupted`, `JobCancelledError`,
        `ObjectDamagedError`.
        """
        store = self.platform.store
        manifest = case.truth.manifest(self.platform)
        pack = None if case.is_validation else store.local(case.truth.pack_key)
        watch = sandbox_watch_of(self.attempt, "check", span[1] - span[0])
        examination = Examination(store.local(case.kept_key()), manifest.tokens, span, pack, manifest.grid)
        blamed = (store, self.platform.database, [case.zip_key, case.truth.pack_key], "the file of this submission")
        with comparing(*blamed):
            result = examine(examination, watch)
        if not result.validation.ok:
            refuse_damaged(*blamed)
        if result.counts is not None:
            process_counters().add(FRAMES, ("scored",), span[1] - span[0])
        return result
