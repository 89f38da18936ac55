"""The stage that imports one scene: it checks and copies the files, makes the products, and stores all as blobs.

    tables of the scene, the archive → (child: artefacts in `out/`) → blobs, held by rows of the import until it ends

**Conventions.** Bytes first, then the rows and the job's success in one transaction. The child's answer about the
labels is in the workspace as `published/<ordinal>.json`, for the stage that publishes all scenes.
"""

import shutil
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from sqlalchemy.orm import Session

from services.domain.imports.requests import begin_run_again, kept_import
from services.domain.sequences.label_sources import SOURCE_INDEX
from services.domain.sequences.run_files import SEQUENCE_FILE
from services.labeler.child_answers import PublicationAnswer
from services.labeler.exports.source import MESH, REPORT, TABLE
from services.labeler.imports.import_workspace import ImportStageContext
from services.labeler.imports.scene_import import import_scene
from services.labeler.imports.scene_parts import OUT, SceneOpening, scene_folder
from services.labeler.label_rows import LABELS
from services.labeler.left_files import LeftFile, files_left, pack_left
from services.runtime.jobs.errors import JobCancelledError
from services.runtime.jobs.specs import Outcome
from services.runtime.orm import ImportedFile
from services.runtime.sandbox import SandboxCrashedError
from services.runtime.store.blobs import PreparedBlob, link, prepare
from stone_files.atomic import atomic_file

TOLD = "published"
NEEDED = (REPORT, TABLE, SEQUENCE_FILE, MESH, SOURCE_INDEX)
LONGEST_NAME = 128


@dataclass(frozen=True)
class _Kept:
    """The results of a scene: its files and their blobs."""

    ordinal: int
    files: list[tuple[LeftFile, PreparedBlob]]


def import_one_scene(context: ImportStageContext) -> Outcome:
    """Import the job's scene.

    Raises the `DST-*` faults, what `ImportStageContext.ask` raises, and `JobCancelledError` if index files were
    deleted; the run is then restarted.
    """
    ordinal = int(context.attempt.arguments["scene"])
    _require_indexed(context, ordinal)
    with context.folder() as folder:
        scene = folder / scene_folder(ordinal)
        shutil.copytree(context.workspace.folder / scene_folder(ordinal), scene)
        with context.archive(folder) as archive:
            opening = SceneOpening(archive, ordinal, context.classes, is_in_place=context.place is not None)
            answer = context.ask(PublicationAnswer, partial(import_scene, opening), "import", (archive, folder))
        kept = _Kept(ordinal, _store_files(context, _files(scene / OUT, answer)))
    _leave(context, ordinal, answer)
    size_bytes = sum(blob.size_bytes for _, blob in kept.files)
    context.attempt.log("imported", scene=ordinal, frames=len(answer.tokens), size_bytes=size_bytes)
    return Outcome({"frames": len(answer.tokens)}, commit=partial(_hold, context, kept))


def answer_path(ordinal: int) -> str:
    """Return the name, in the workspace, of a scene's answer."""
    return f"{TOLD}/{ordinal:06d}.json"


def _require_indexed(context: ImportStageContext, ordinal: int) -> None:
    """Raise `JobCancelledError` if the scene's index files were deleted."""
    context.workspace.pull(f"{scene_folder(ordinal)}/")
    if not (context.workspace.folder / scene_folder(ordinal)).is_dir():
        gone = "its index files were deleted"
        begin_run_again(context.platform, context.attempt, gone)
        raise JobCancelledError(gone)


def _files(out: Path, answer: PublicationAnswer) -> list[LeftFile]:
    """Return the artefacts of the scene. Raises `SandboxCrashedError` if they differ from the answer."""
    files = {file.name: file for file in files_left(out)} if out.is_dir() and not out.is_symlink() else {}
    packs = {f"{LABELS}{Path(pack.name).name}": pack for pack in answer.packs}
    missing = [name for name in (*NEEDED, *packs) if name not in files]
    unasked = [name for name in files if len(name) > LONGEST_NAME or (name.startswith(LABELS) and name not in packs)]
    if missing or unasked:
        raise SandboxCrashedError(f"wrote a scene without {missing[:3]}, or with {unasked[:3]}")
    return [pack_left(file.path, packs[name]) if name in packs else file for name, file in files.items()]


def _store_files(context: ImportStageContext, files: list[LeftFile]) -> list[tuple[LeftFile, PreparedBlob]]:
    stored = list[tuple[LeftFile, PreparedBlob]]()
    for number, file in enumerate(files):
        context.attempt.progress("store", number, len(files))
        stored.append((file, prepare(context.platform.store, context.platform.database, file.path, adopt=True)))
    context.attempt.progress("store", len(files), len(files))
    return stored


def _leave(context: ImportStageContext, ordinal: int, answer: PublicationAnswer) -> None:
    path = context.workspace.folder / answer_path(ordinal)
    path.parent.mkdir(exist_ok=True)
    with atomic_file(path) as staging:
        staging.write_bytes(answer.packed())
    context.workspace.push(answer_path(ordinal))


def _hold(context: ImportStageContext, kept: _Kept, session: Session) -> None:
    """Write the rows that hold the scene's blobs. Raises `JobCancelledError`."""
    imported = kept_import(session, context.attempt)
    for file, prepared in sorted(kept.files, key=lambda pair: pair[1].sha256):  # the common order of links
        blob = link(session, prepared)
        row = ImportedFile(import_id=imported.id, scene=kept.ordinal, name=file.name, media_type=file.media_type)
        row.blob_sha256, row.size_bytes = blob.sha256, blob.size_bytes
        session.add(row)
        session.flush()
