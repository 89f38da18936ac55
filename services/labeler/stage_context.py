"""The context of a labelling stage: its run as values, its files in the workspace, its progress reports."""

from dataclasses import dataclass
from functools import partial
from typing import Any

from services.domain.sequences.restart import arguments_of_run
from services.domain.sequences.run_files import SEQUENCE_FILE, SWEEPS_FILE
from services.domain.sequences.stage_checks import require_sequence
from services.labeler.errors import WorkGoneError
from services.labeler.parameters import chosen_parameters
from services.labeler.recordings import described_sweeps
from services.labeler.run import LabelRun, Step
from services.labeler.stage import StageFiles
from services.runtime.jobs.specs import Attempt
from services.runtime.platform import Platform
from services.runtime.store.workspace import Workspace
from stone.sensors.sequence import Sweep, SweepSource
from stone_recordings.sync.sequence_file import read_sequence


@dataclass
class LateSweeps:
    """Sweeps that are opened when the first is asked for: most stages ask for none."""

    platform: Platform
    description: bytes
    opened: SweepSource | None = None

    def sweep(self, index: int) -> Sweep:
        if self.opened is None:
            self.opened = described_sweeps(self.platform, self.description)
        return self.opened.sweep(index)


@dataclass(frozen=True, eq=False)
class LabelStageContext:
    """`arguments` are those of the whole run, `attempt.arguments` those of this job."""

    platform: Platform
    attempt: Attempt
    arguments: dict[str, Any]
    workspace: Workspace
    run: LabelRun

    def pull(self, files: StageFiles) -> None:
        """Make local what earlier stages left. Raises `WorkGoneError` where nothing is left of what is required."""
        self.workspace.pull(*files.reads)
        for name in files.requires:
            if not (self.run.scratch / name).exists():
                self.workspace.pull(name)
            if not (self.run.scratch / name).exists():
                raise WorkGoneError(name)

    def push(self, files: StageFiles) -> None:
        """Leave for later stages what was written."""
        found = (path for pattern in files.writes for path in sorted(self.run.scratch.glob(pattern)))
        self.workspace.push(*(path.relative_to(self.run.scratch).as_posix() for path in found))

    def step(self, stage: str) -> Step:
        """What a stage calls as it goes on; raises `JobCancelledError` when it is to stop."""
        return partial(self.attempt.progress, stage)


def stage_context_of(platform: Platform, attempt: Attempt) -> LabelStageContext:
    """The stage context of this attempt.

    Raises `JobCancelledError` when the sequence was deleted or other code's run is begun again, `CodeChangedError` when
    it cannot be, `WorkGoneError`.
    """
    with platform.database.reading() as session:
        require_sequence(session, attempt)
    arguments = arguments_of_run(platform, attempt)
    workspace = Workspace(platform.store, platform.settings, attempt.root_id)
    workspace.pull(SEQUENCE_FILE, SWEEPS_FILE)
    if not (workspace.folder / SWEEPS_FILE).exists():
        raise WorkGoneError(SWEEPS_FILE)
    sequence = read_sequence((workspace.folder / SEQUENCE_FILE).read_bytes())
    sweeps = LateSweeps(platform, (workspace.folder / SWEEPS_FILE).read_bytes())
    parameters = chosen_parameters(arguments["profile"], arguments["parameters"])
    run = LabelRun(sequence, sweeps, parameters, workspace.folder)
    return LabelStageContext(platform, attempt, arguments, workspace, run)
