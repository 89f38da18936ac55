"""The stage that indexes a dataset: its tables are checked, parted by scene, and a job is made of each scene.

    the archive → (child: tables of each scene, spans of its files) → `scenes/<ordinal>/` in the workspace → jobs

**Conventions.** Folders of scenes are renamed into place; equal archives give equal ones. What can be known to be
refused is refused here, before any scene is copied: scenes without labels, sequences that are there already.
"""

from functools import partial
from pathlib import Path

from sqlalchemy.orm import Session

from services.domain.imports.errors import _shown
from services.domain.imports.publication import refuse_existing
from services.domain.imports.requests import PUBLISH_IMPORT, SCENE, kept_import
from services.labeler.imports.answers import DatasetIndexAnswer
from services.labeler.imports.import_workspace import ImportStageContext
from services.labeler.imports.indexing import index_dataset
from services.labeler.imports.scene_parts import SCENES, DatasetOpening, scene_folder
from services.runtime.jobs.specs import JobSpec, Outcome
from services.runtime.sandbox import SandboxCrashedError
from stone.errors import Refused


def index_tar(context: ImportStageContext) -> Outcome:
    """Index the dataset.

    Raises the `DST-*` faults, `scenes_unlabelled`, `sequences_exist`, and what `ImportStageContext.ask`
    raises.
    """
    imported = context.imported
    with context.folder() as folder:
        with context.archive(folder) as archive:
            opening = DatasetOpening(archive, imported.name, imported.sha256, context.classes, context.stated)
            told = context.ask(DatasetIndexAnswer, partial(index_dataset, opening), "index", (archive, folder))
        _refuse(context, told)
        for scene in told.scenes:
            _keep(folder, context.workspace.folder, scene.ordinal)
    context.workspace.push(f"{SCENES}/")
    frames = sum(scene.frames for scene in told.scenes)
    context.attempt.log("indexed", scenes=len(told.scenes), frames=frames)
    result = {"scenes": len(told.scenes), "frames": frames}
    return Outcome(result, then=_jobs(told), commit=partial(_write, context, told))


def _refuse(context: ImportStageContext, told: DatasetIndexAnswer) -> None:
    if unlabelled := [scene.name for scene in told.scenes if not scene.is_labelled]:
        raise Refused(
            "scenes_unlabelled",
            f"{len(unlabelled)} scenes have no labels in gts/, or not of every frame: {_shown(unlabelled)}; what "
            "has no labels is no label set: upload its recording instead, or leave these scenes out of the tables",
        )
    with context.platform.database.reading() as session:
        refuse_existing(session, context.imported, [scene.name for scene in told.scenes])


def _keep(folder: Path, work: Path, ordinal: int) -> None:
    """Move a scene's folder into the workspace, whole, unless another attempt has put the same there.

    Raises `SandboxCrashedError` where the child left none.
    """
    left, kept = folder / scene_folder(ordinal), work / scene_folder(ordinal)
    if left.is_symlink() or not left.is_dir():
        raise SandboxCrashedError(f"spoke of scene {ordinal} and left no files of it")
    kept.parent.mkdir(parents=True, exist_ok=True)
    try:
        left.rename(kept)
    except OSError:  # it is there, and not empty
        if not kept.is_dir():
            raise


def _jobs(told: DatasetIndexAnswer) -> tuple[JobSpec, ...]:
    scenes = [JobSpec(SCENE, {"scene": scene.ordinal}, f"scene {scene.ordinal}") for scene in told.scenes]
    return (*scenes, JobSpec(PUBLISH_IMPORT, {}, "publish", tuple(scene.key for scene in scenes)))


def _write(context: ImportStageContext, told: DatasetIndexAnswer, session: Session) -> None:
    """Raises `JobCancelledError`."""
    kept_import(session, context.attempt).scenes = [
        {"name": scene.name, "frames": scene.frames, "splits": list(scene.splits), "region": scene.region}
        for scene in told.scenes
    ]
