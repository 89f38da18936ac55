"""Where a stage works in the queue: its run as values, its files in the workspace, its voice."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from services.labeler.errors import CodeChangedError, WorkGoneError
from services.labeler.parameters import chosen_parameters
from services.labeler.run import Run, Step
from services.runtime.jobs.specs import Attempt
from services.runtime.orm import Job
from services.runtime.platform import Platform
from services.runtime.recipes import CODE_VERSION
from services.runtime.run_files import SEQUENCE_FILE, SWEEPS_FILE
from services.runtime.sequence_file import read_sequence
from services.runtime.stages import standing_sequence
from services.runtime.sweep_sources import open_sweeps
from services.runtime.workspace import Workspace
from stone.sequence import Sweep, SweepSource


@dataclass
class LateSweeps:
    """Sweeps that are opened when the first is asked for: most stages ask for none."""

    platform: Platform
    description: bytes
    opened: SweepSource | None = None

    def sweep(self, index: int) -> Sweep:
        if self.opened is None:
            self.opened = open_sweeps(self.platform, self.description)
        return self.opened.sweep(index)


@dataclass(frozen=True, eq=False)
class Desk:
    """`arguments` are those of the whole run, `attempt.arguments` those of this job."""

    platform: Platform
    attempt: Attempt
    arguments: dict[str, Any]
    workspace: Workspace
    run: Run

    def pull(self, *prefixes: str) -> None:
        """Make local what earlier stages left. Raises `WorkGoneError` where one of them has nothing there."""
        self.workspace.pull(*prefixes)
        for prefix in prefixes:
            if not (self.run.scratch / prefix).exists():
                raise WorkGoneError(prefix)

    def push(self, *paths: Path) -> None:
        """Leave these files for later stages."""
        self.workspace.push(*(path.relative_to(self.run.scratch).as_posix() for path in paths if path.exists()))

    def step(self, stage: str) -> Step:
        """What a stage calls as it goes on; raises `JobCancelledError` when it is to stop."""
        return partial(self.attempt.progress, stage)


def desk_of(platform: Platform, attempt: Attempt) -> Desk:
    """The desk of this attempt.

    Raises `JobCancelledError` when the sequence was deleted, `CodeChangedError`, `WorkGoneError`.
    """
    with platform.database.reading() as session:
        standing_sequence(session, attempt)
        arguments = session.get_one(Job, attempt.root_id).arguments
    if arguments["code_version"] != CODE_VERSION:
        raise CodeChangedError(arguments["code_version"], CODE_VERSION)
    workspace = Workspace(platform.store, platform.settings, attempt.root_id)
    workspace.pull(SEQUENCE_FILE, SWEEPS_FILE)
    if not (workspace.folder / SWEEPS_FILE).exists():
        raise WorkGoneError(SWEEPS_FILE)
    sequence = read_sequence((workspace.folder / SEQUENCE_FILE).read_bytes())
    sweeps = LateSweeps(platform, (workspace.folder / SWEEPS_FILE).read_bytes())
    parameters = chosen_parameters(arguments["profile"], arguments["parameters"])
    run = Run(sequence, sweeps, parameters, workspace.folder)
    return Desk(platform, attempt, arguments, workspace, run)
