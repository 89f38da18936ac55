"""The labeler's handlers for an import of a dataset: three stages, by kind.

    ingest keeps the archive → index → import (each scene) → publish (all of them at once)

**Conventions.** As in `services/labeler/queue_handlers.py`: a stage may run twice, concurrently or after being killed
anywhere. A dataset is untrusted, so only a sandboxed child opens it. A finished scene is never imported again.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.domain.exports.requests import follow_labels
from services.domain.imports.publication import PublishedScene, end_import, follow_splits, sequences_of_scenes
from services.domain.imports.requests import INDEX, PUBLISH_IMPORT, SCENE, begin_run_again, kept_import
from services.domain.viewer.playback import PLAYBACK
from services.labeler.child_answers import PublicationAnswer
from services.labeler.imports.import_workspace import ImportStageContext, import_context_of
from services.labeler.imports.index_stage import index_tar
from services.labeler.imports.scene_stage import TOLD, answer_path, import_one_scene
from services.labeler.label_rows import (
    LABELS,
    NewArtefact,
    NewLabelSet,
    standing_label_set,
    write_artefact,
    write_label_set,
)
from services.runtime.jobs.errors import JobCancelledError
from services.runtime.jobs.specs import Attempt, Handlers, Outcome
from services.runtime.orm import DatasetImport, ImportedFile, Job, SequenceRow
from services.runtime.platform import Platform
from services.runtime.sandbox import SandboxCrashedError
from services.runtime.store.faults import comparing
from services.runtime.store.recipes import recipe_of

# The stage that publishes a dataset: sequences, label sets and frames of all its scenes, in one transaction. All bytes
# are already in the store, held by rows of the import; the stage reads only the answers of the scenes' children, and
# validates them again.


PROFILE = "imported"
COUNTED = (LABELS, "source/")


@dataclass(frozen=True)
class _SceneRows:
    """The rows of a scene: its files, and the answer about its labels."""

    answer: PublicationAnswer
    files: tuple[NewArtefact, ...]

    @property
    def size_bytes(self) -> int:
        """The bytes that count against the owner: those of the labels and of the dataset's files."""
        return sum(file.size_bytes for file in self.files if file.name.startswith(COUNTED))


def publish_scenes(context: ImportStageContext) -> Outcome:
    """Publish the dataset.

    Raises `sequences_exist` and `quota_exceeded` at the commit, `SandboxCrashedError`, and `JobCancelledError` if
    intermediate files were deleted; the run is then restarted.
    """
    context.workspace.pull(f"{TOLD}/")
    with context.platform.database.reading() as session:
        files = _files(session, context.imported)
    scenes = [_scene(context, ordinal, files.get(ordinal, [])) for ordinal in range(len(context.imported.scenes or []))]
    frames = sum(len(scene.answer.tokens) for scene in scenes)
    context.attempt.log("published", scenes=len(scenes), frames=frames)
    return Outcome({"scenes": len(scenes), "frames": frames}, commit=partial(_write, context, scenes))


def _files(session: Session, imported: DatasetImport) -> dict[int, list[ImportedFile]]:
    held = select(ImportedFile).where(ImportedFile.import_id == imported.id).order_by(ImportedFile.scene)
    return {scene: list(files) for scene, files in groupby(session.scalars(held), key=lambda file: file.scene)}


def _scene(context: ImportStageContext, ordinal: int, files: Sequence[ImportedFile]) -> _SceneRows:
    """Return the rows of a scene. Raises `JobCancelledError`, `SandboxCrashedError`."""
    path = context.workspace.folder / answer_path(ordinal)
    if not path.exists():
        gone = "the intermediate files of its scenes were deleted"
        begin_run_again(context.platform, context.attempt, gone)
        raise JobCancelledError(gone)
    answer = PublicationAnswer.believed(path.read_bytes())
    packs = {f"{LABELS}{pack.name.rpartition('/')[2]}": pack for pack in answer.packs}
    artefacts = tuple(
        NewArtefact(file.name, file.media_type, file.blob_sha256, file.size_bytes, packs.pop(file.name, None))
        for file in files
    )
    if packs or any(file.pack is not None and file.pack.size_bytes != file.size_bytes for file in artefacts):
        raise SandboxCrashedError(f"listed packs of scene {ordinal} other than the stored packs")
    return _SceneRows(answer, artefacts)


def _write(context: ImportStageContext, scenes: Sequence[_SceneRows], session: Session) -> None:
    imported = kept_import(session, context.attempt)
    sequences = sequences_of_scenes(session, imported)
    made = [_write_scene(context, session, sequence, scene) for sequence, scene in zip(sequences, scenes, strict=True)]
    end_import(session, imported, made, context.platform.settings.uploads.owner_bytes)
    result: dict[str, Any] = {"import_id": imported.id, "sequences": len(made)}
    if imported.sets_splits:
        result["splits_refused"] = list(follow_splits(session, imported))
    session.get_one(Job, context.attempt.root_id).result = result


def _write_scene(
    context: ImportStageContext, session: Session, sequence: SequenceRow, scene: _SceneRows
) -> PublishedScene:
    imported = context.imported
    made_of = {"dataset": imported.sha256, "scene": sequence.name, "classes": imported.classes}
    made_of |= {"stated": imported.stated} if imported.stated else {}
    recipe = recipe_of("imports", made_of)
    standing = standing_label_set(session, sequence.id, recipe)
    if standing is not None:
        return PublishedScene(sequence.id, standing.id, 0)
    parameters = {"profile": PROFILE, "dataset": imported.name, "sha256": imported.sha256, "classes": imported.classes}
    new = NewLabelSet(sequence.id, context.attempt.root_id, recipe, parameters, "imports", scene.answer.grid)
    labels = write_label_set(session, new, scene.answer)
    labels.source_place = imported.place
    for file in scene.files:
        write_artefact(session, labels.id, file, scene.answer)
    if context.platform.settings.viewing.makes_playback:
        follow_labels(session, sequence, labels, PLAYBACK)
    return PublishedScene(sequence.id, labels.id, scene.size_bytes)


STAGES = {INDEX: index_tar, SCENE: import_one_scene, PUBLISH_IMPORT: publish_scenes}


def import_handlers(platform: Platform) -> Handlers:
    """Return the stages by kind."""
    return {kind: partial(_with_context, platform, stage) for kind, stage in STAGES.items()}


def _with_context(platform: Platform, stage: Callable[[ImportStageContext], Outcome], attempt: Attempt) -> Outcome:
    context = import_context_of(platform, attempt)
    with comparing(platform.store, platform.database, context.stored_archive(), "the archive"):
        return stage(context)
