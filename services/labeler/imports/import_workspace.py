"""The context of a stage of an import: the dataset's archive, the run's files, and the sandbox.

**Conventions.** An attempt works in its own hidden folder in the run's workspace. Results move atomically from there
into the workspace, or into the store. The child may read the archive, and writes only to that folder.
"""

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from sqlalchemy import select

from services.domain.imports.requests import import_of_attempt, place_of
from services.labeler.imports.kernel_warmup import warm_imports
from services.runtime.in_place.datasets import DatasetArchivePath, opened_dataset
from services.runtime.jobs.errors import JobCancelledError
from services.runtime.jobs.specs import Attempt
from services.runtime.orm import Blob, DatasetImport, Job
from services.runtime.platform import Platform
from services.runtime.sandbox.answers import SandboxAnswer
from services.runtime.sandbox.job_sandbox import JobSandbox, SandboxedWork, private_folder_in
from services.runtime.store.workspace import Workspace, fresh_folder
from stone_datasets.classes import OWN_CLASSES, ClassMap, class_map_of
from stone_datasets.stated_layout import StatedLayout
from stone_recordings.sync.stored_recording import RecordingPlace

APART = ".import-"
A = TypeVar("A", bound=SandboxAnswer)


@dataclass(frozen=True, eq=False)
class ImportStageContext:
    """`imported` is the import's row at the start of the attempt."""

    platform: Platform
    attempt: Attempt
    imported: DatasetImport
    workspace: Workspace

    @property
    def classes(self) -> ClassMap:
        """The meaning of its label numbers."""
        stated = self.imported.classes
        if stated is None:
            return OWN_CLASSES
        return class_map_of(stated["name"], {int(number): meaning for number, meaning in stated["classes"].items()})

    @property
    def stated(self) -> StatedLayout:
        """The layout and grid stated by its owner."""
        return StatedLayout.of_record(self.imported.stated)

    @property
    def place(self) -> RecordingPlace | None:
        """The place of an archive that is read in place."""
        return place_of(self.imported)

    @contextmanager
    def archive(self, folder: Path) -> Iterator[DatasetArchivePath]:
        """Yield the archive for a child that may write to the folder: its local path, or its ranges.

        Raises `JobCancelledError` if the import was deleted meanwhile, and what the store and `opened_dataset` raise.
        """
        if self.place is None:
            yield self._kept()
            return
        with opened_dataset(self.platform.settings.in_place, self.place, folder, self._fetched) as archive:
            yield archive

    def _fetched(self, read_bytes: int) -> None:
        self.attempt.log("fetched", read_bytes=read_bytes, size_bytes=self.imported.size_bytes)

    def _kept(self) -> Path:
        for key in self.stored_archive():
            return self.platform.store.local(key)
        raise JobCancelledError("its dataset was deleted")

    def stored_archive(self) -> Sequence[str]:
        """Return the object key of the archive; empty if the archive is in place or was deleted."""
        with self.platform.database.reading() as session:
            kept = select(Blob.object_key).join(DatasetImport, DatasetImport.blob_sha256 == Blob.sha256)
            return session.scalars(kept.where(DatasetImport.id == self.imported.id)).all()

    def folder(self) -> AbstractContextManager[Path]:
        """Return a fresh folder of this attempt, as `fresh_folder`; folders of the run's ended jobs are deleted."""
        ended = [f"{APART}{job_id}" for job_id in self._ended_jobs()]
        return fresh_folder(self.workspace.folder, f"{APART}{self.attempt.job_id}", ended)

    def ask(self, answer: type[A], work: SandboxedWork, shown: str, opened: tuple[DatasetArchivePath, Path]) -> A:
        """Return the answer of a sandboxed child, which may read the archive and write to the folder of `opened`.

        Raises what `work` raises, `SandboxCrashedError`, `SandboxInterruptedError`, `JobCancelledError`.
        """
        archive, folder = opened
        reads = (archive,) if isinstance(archive, Path) else ()
        with private_folder_in(folder) as temporary:
            sandbox = JobSandbox(folder, reads, self.attempt, self.platform.settings, warm_imports, temporary)
            return answer.believed(sandbox.run(work, shown, 1))

    def _ended_jobs(self) -> Sequence[str]:
        succeeded = select(Job.id).where(Job.root_id == self.attempt.root_id, Job.state == "succeeded")
        with self.platform.database.reading() as session:
            return session.scalars(succeeded).all()


def import_context_of(platform: Platform, attempt: Attempt) -> ImportStageContext:
    """Return the context of this attempt. Raises as `import_of_attempt`."""
    imported = import_of_attempt(platform, attempt)
    return ImportStageContext(
        platform, attempt, imported, Workspace(platform.store, platform.settings, attempt.root_id)
    )
