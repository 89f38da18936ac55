"""The stage that indexes a dataset: it checks the tables, divides them by scene, and creates a job for each scene.

    the archive → (child: tables of each scene, spans of its files) → `scenes/<ordinal>/` in the workspace → jobs

**Conventions.** Folders of scenes are renamed into place; equal archives give equal folders. Faults that are already
known are refused here, before any scene is copied: scenes without labels, existing sequences.
"""

from functools import partial
from pathlib import Path

from sqlalchemy.orm import Session

from services.domain.imports.errors import _shown
from services.domain.imports.kept_files import keep_file
from services.domain.imports.publication import refuse_existing
from services.domain.imports.requests import PUBLISH_IMPORT, SCENE, kept_import
from services.labeler.imports.answers import DatasetIndexAnswer
from services.labeler.imports.import_workspace import ImportStageContext
from services.labeler.imports.indexing import index_dataset
from services.labeler.imports.scene_parts import SCENES, DatasetOpening, extra_path, scene_folder
from services.runtime.jobs.specs import JobSpec, Outcome
from services.runtime.sandbox import SandboxCrashedError
from services.runtime.store.blobs import PreparedBlob, link, prepare
from stone.errors import Refused


def index_tar(context: ImportStageContext) -> Outcome:
    """Index the dataset.

    Raises the `DST-*` faults, `scenes_unlabelled`, `sequences_exist`, and what `ImportStageContext.ask` raises.
    """
    imported = context.imported
    with context.folder() as folder:
        with context.archive(folder) as archive:
            opening = DatasetOpening(archive, imported.name, imported.sha256, context.classes, context.stated)
            index = context.ask(DatasetIndexAnswer, partial(index_dataset, opening), "index", (archive, folder))
        _refuse(context, index)
        for scene in index.scenes:
            _keep(folder, context.workspace.folder, scene.ordinal)
        kept = _store_extra(context, folder, index)
    context.workspace.push(f"{SCENES}/")
    frames = sum(scene.frames for scene in index.scenes)
    context.attempt.log("indexed", scenes=len(index.scenes), frames=frames)
    result = {"scenes": len(index.scenes), "frames": frames}
    return Outcome(result, then=_jobs(index), commit=partial(_write, context, index, kept))


def _store_extra(
    context: ImportStageContext, folder: Path, index: DatasetIndexAnswer
) -> list[tuple[str, PreparedBlob]]:
    """Store the files outside the tables by name. Raises `SandboxCrashedError` if they differ from the answer."""
    stored = list[tuple[str, PreparedBlob]]()
    for number, file in enumerate(index.extra):
        path = extra_path(folder, number)
        if (
            path.parent.is_symlink()
            or path.is_symlink()
            or not path.is_file()
            or path.stat().st_size != file.size_bytes
        ):
            raise SandboxCrashedError(f"listed file {number} but wrote another file")
        stored.append((file.name, prepare(context.platform.store, context.platform.database, path, adopt=True)))
    return stored


def _refuse(context: ImportStageContext, index: DatasetIndexAnswer) -> None:
    if unlabelled := [scene.name for scene in index.scenes if not scene.is_labelled]:
        raise Refused(
            "scenes_unlabelled",
            f"{len(unlabelled)} scenes have no labels in gts/, or not for every frame: {_shown(unlabelled)}; upload "
            "the recordings of scenes without labels, or remove these scenes from the tables",
        )
    with context.platform.database.reading() as session:
        refuse_existing(session, context.imported, [scene.name for scene in index.scenes])


def _keep(folder: Path, work: Path, ordinal: int) -> None:
    """Move a scene's folder atomically into the workspace, unless another attempt has already done so.

    Raises `SandboxCrashedError` if the child wrote no folder.
    """
    left, kept = folder / scene_folder(ordinal), work / scene_folder(ordinal)
    if left.is_symlink() or not left.is_dir():
        raise SandboxCrashedError(f"listed scene {ordinal} but wrote no files for it")
    kept.parent.mkdir(parents=True, exist_ok=True)
    try:
        left.rename(kept)
    except OSError:  # the folder exists and is not empty
        if not kept.is_dir():
            raise


def _jobs(index: DatasetIndexAnswer) -> tuple[JobSpec, ...]:
    scenes = [JobSpec(SCENE, {"scene": scene.ordinal}, f"scene {scene.ordinal}") for scene in index.scenes]
    return (*scenes, JobSpec(PUBLISH_IMPORT, {}, "publish", tuple(scene.key for scene in scenes)))


def _write(
    context: ImportStageContext, index: DatasetIndexAnswer, kept: list[tuple[str, PreparedBlob]], session: Session
) -> None:
    """Write the index. Raises `JobCancelledError`."""
    imported = kept_import(session, context.attempt)
    for name, prepared in sorted(kept, key=lambda file: file[1].sha256):  # the common order of links
        keep_file(session, imported, name, link(session, prepared))
    imported.left_out = {
        "total": index.left_out_total,
        "files": [oversized.model_dump() for oversized in index.left_out],
    }
    imported.scenes = [
        {"name": scene.name, "frames": scene.frames, "splits": list(scene.splits), "region": scene.region}
        for scene in index.scenes
    ]
