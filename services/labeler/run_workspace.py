"""The context of a labelling stage: its run's files in the workspace, and the sandbox that opens them."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar

from services.domain.sequences.chosen_recordings import recording_ids_of
from services.domain.sequences.recordings import kept_recording, locate_run, unchanged
from services.domain.sequences.restart import arguments_of_run
from services.domain.sequences.run_files import SEQUENCE_FILE, SWEEPS_FILE, require_left
from services.labeler.kernel_warmup import warm
from services.labeler.sandboxed_run import RunOpening
from services.runtime.jobs.errors import JobCancelledError
from services.runtime.jobs.specs import Attempt
from services.runtime.orm import Recording
from services.runtime.platform import Platform
from services.runtime.sandbox.answers import SandboxAnswer
from services.runtime.sandbox.job_sandbox import JobSandbox, SandboxedWork, private_folder_in
from services.runtime.store.workspace import Workspace
from stone_base.label_grid import recorded_grid
from stone_files.bag_fingerprint import bag_paths
from stone_files.joined_file import JOINED
from stone_recordings.sync.stored_recording import StoredRecording

A = TypeVar("A", bound=SandboxAnswer)


@dataclass(frozen=True, eq=False)
class LabelStageContext:
    """`arguments` are those of the whole run, `attempt.arguments` those of this job."""

    platform: Platform
    attempt: Attempt
    arguments: dict[str, Any]
    workspace: Workspace

    @property
    def opening(self) -> RunOpening:
        """The run, for stages that read no sweeps."""
        grid = recorded_grid(self.arguments.get("grid"))
        return RunOpening(self.workspace.folder, self.arguments["profile"], self.arguments["parameters"], grid=grid)

    def opening_with_sweeps(self) -> RunOpening:
        """Return the run and its local recordings. Raises `JobCancelledError` if a recording was deleted."""
        recording = locate_run(self.platform, self.recordings, self.workspace.folder)
        is_in_place = any(stored.place is not None for stored in self.recordings)
        return replace(self.opening, recording=recording, is_in_place=is_in_place)

    @cached_property
    def recordings(self) -> tuple[StoredRecording, ...]:
        """The recordings of the run. Raises `JobCancelledError` if one was deleted."""
        with self.platform.database.lookups() as session:
            recordings = [session.get(Recording, recording_id) for recording_id in recording_ids_of(self.arguments)]
            kept = tuple(kept_recording(session, recording) for recording in recordings if recording is not None)
        if len(kept) < len(recordings):
            raise JobCancelledError("its recording was deleted")
        return kept

    def ask(self, answer: type[A], work: SandboxedWork, shown: str, opening: RunOpening) -> A:
        """Return the answer of a sandboxed child that may open the files of `opening`.

        Raises what `work` raises, `SandboxCrashedError`, `SandboxInterruptedError`, `JobCancelledError`.
        """
        bag = opening.recording
        reads = () if bag is None else bag_paths(bag)
        settings, folder = self.platform.settings, opening.folder
        read = () if bag is None else self.recordings
        with private_folder_in(folder) as temporary, unchanged(self.platform, read):
            sandbox = JobSandbox(folder, reads, self.attempt, settings, warm, temporary, shares_run=True)
            return answer.believed(sandbox.run(work, shown, 1))

    def pull(self, reads: tuple[str, ...], requires: tuple[str, ...]) -> None:
        """Copy the outputs of earlier stages to this machine. Raises `work_gone` if a required file is missing."""
        folder = self.workspace.folder
        self.workspace.pull(*reads)
        self.workspace.pull(*(name for name in requires if not (folder / name).exists()))
        require_left(folder, requires)


def stage_context_of(platform: Platform, attempt: Attempt) -> LabelStageContext:
    """Return the stage context of this attempt.

    Raises `JobCancelledError` if the sequence was deleted or a run of another code version is restarted, `code_changed`
    if it cannot be restarted, `work_gone`.
    """
    arguments = arguments_of_run(platform, attempt)
    workspace = Workspace(platform.store, platform.settings, attempt.root_id)
    workspace.pull(SEQUENCE_FILE, SWEEPS_FILE, JOINED)
    require_left(workspace.folder, (SWEEPS_FILE, SEQUENCE_FILE))
    return LabelStageContext(platform, attempt, arguments, workspace)
