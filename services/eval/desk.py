"""Where a stage of the queue `eval` works: the platform, its attempt, a folder, and a watch over what it confines."""

from dataclasses import dataclass
from pathlib import Path

from services.eval.cases import Case, case_of
from services.eval.examining import Examination, Examined, Span, examine
from services.runtime.benchmarks.pairs import Pair
from services.runtime.confined.watching import watching
from services.runtime.jobs.specs import Attempt
from services.runtime.platform import Platform
from services.runtime.telemetry.meters import FRAMES
from services.runtime.telemetry.tallies import tallies
from services.runtime.workspace import Workspace


@dataclass(frozen=True, eq=False)
class Desk:
    """What every stage is handed."""

    platform: Platform
    attempt: Attempt

    @property
    def submission_id(self) -> str:
        return str(self.attempt.arguments["submission_id"])

    @property
    def pair(self) -> Pair:
        """The pair of a join."""
        return Pair(self.attempt.arguments["truth_id"], self.attempt.arguments["metric"])

    @property
    def folder(self) -> Path:
        """Of the run; it goes some time after the run has ended."""
        return Workspace(self.platform.store, self.platform.settings, self.attempt.root_id).folder

    def case(self, truth_id: str) -> Case:
        """As the rows have it now. Raises `JobCancelledError`, `TruthUnreadyError`."""
        with self.platform.database.reading() as session:
            return case_of(session, self.submission_id, truth_id)

    def examined(self, case: Case, span: Span) -> Examined:
        """The frames [start, stop) of the submission, counted unless it is only to be checked.

        Raises `PurgedError`, `ScoringCrashedError`, `ScoringInterruptedError`, `JobCancelledError`.
        """
        store = self.platform.store
        tokens = case.truth.manifest(self.platform).tokens
        pack = None if case.is_validation else store.local(case.truth.pack_key)
        watch = watching(self.attempt, "check", span[1] - span[0])
        found = examine(Examination(store.local(case.kept_key()), tokens, span, pack), watch)
        if found.counts is not None:
            tallies().add(FRAMES, ("scored",), span[1] - span[0])
        return found
