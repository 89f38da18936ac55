"""The publish stage: stores the files of a run as blobs and writes the rows of the label set.

**Conventions.** Bytes first, outside any transaction; then all rows or none. Beside what is written here, every file
in the workspace's folder `map` is published under its name. A run whose sequence was deleted meanwhile writes no row
and ends cancelled.
"""

from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

from sqlalchemy import insert, select
from sqlalchemy.orm import Session

from services.domain.exports.requests import follow_labels
from services.domain.sequences.chosen_recordings import recording_ids_of
from services.domain.sequences.run_files import SEQUENCE_FILE
from services.domain.sequences.stage_checks import require_sequence
from services.domain.viewer.playback import PLAYBACK
from services.labeler.exports.source import REPORT, TABLE
from services.labeler.map.comparison import COMPARISON
from services.labeler.map.far_points import FAR
from services.labeler.map.map_files import MAP
from services.labeler.map.track_coverage import COVERAGE
from services.labeler.parameters import chosen_parameters
from services.labeler.publication_files import PUBLISHED
from services.labeler.run_answers import FilesAnswer, PackAnswer, PublicationAnswer
from services.labeler.sandboxed_run import described
from services.labeler.stage_context import LabelStageContext
from services.runtime.code_version import code_version
from services.runtime.jobs.specs import Outcome
from services.runtime.orm import Artefact, Job, LabelledFrameRow, LabelSet, new_id
from services.runtime.sandbox import SandboxCrashedError
from services.runtime.store.blobs import PreparedBlob, link, prepare
from services.runtime.store.keys import checked
from stone_files.joined_file import JOINED

MEDIA_TYPES = {
    ".json": "application/json",
    ".parquet": "application/vnd.apache.parquet",
    ".ply": "model/ply",
    ".glb": "model/gltf-binary",
    ".png": "image/png",
    ".jpg": "image/jpeg",
    ".gif": "image/gif",
    ".mp4": "video/mp4",
}


NEEDED = ("sums", "packs", FAR, MAP, COMPARISON, COVERAGE)
FILES = FilesAnswer(reads=NEEDED, requires=NEEDED, writes=())


@dataclass(frozen=True)
class _File:
    """A file to publish; `name` is its artefact's. `pack` says of a pack where its frames lie."""

    name: str
    media_type: str
    path: Path
    pack: PackAnswer | None = None


@dataclass(frozen=True)
class _Publication:
    """What is written in one transaction: stored files, and what a child said of them."""

    context: LabelStageContext
    prepared: list[tuple[_File, PreparedBlob]]
    told: PublicationAnswer


def publish(context: LabelStageContext) -> Outcome:
    """Write the report and the frame table, store all files, and answer with the rows to write.

    Raises what `LabelStageContext.ask` raises, and `SandboxCrashedError` for packs that are shorter than was said.
    """
    context.pull(FILES)
    told = context.ask(PublicationAnswer, partial(described, context.opening), "publish", context.opening)
    files, prepared = _files(context, told), list[tuple[_File, PreparedBlob]]()
    for number, file in enumerate(files):
        context.attempt.progress("publish", number, len(files))
        prepared.append((file, prepare(context.platform.store, context.platform.database, file.path, adopt=True)))
    context.attempt.progress("publish", len(files), len(files))
    context.attempt.log("stored", files=len(files), size_bytes=sum(blob.size_bytes for _, blob in prepared))
    rows = _Publication(context, prepared, told)
    return Outcome({"frames": len(told.tokens)}, commit=partial(_write_rows, rows))


def _files(context: LabelStageContext, told: PublicationAnswer) -> list[_File]:
    folder, is_joined = context.workspace.folder, len(recording_ids_of(context.arguments)) > 1
    return [
        _named(REPORT, folder / PUBLISHED / REPORT),
        _named(TABLE, folder / PUBLISHED / TABLE),
        _named(SEQUENCE_FILE, folder / SEQUENCE_FILE),
        *([_named(JOINED, folder / JOINED)] if is_joined else []),
        *_drawn(folder / MAP),
        *(_packed(folder, pack) for pack in told.packs),
    ]


def _drawn(folder: Path) -> list[_File]:
    """Every file below the folder in the order of their names, but those that are still being written.

    Raises `BadKeyError` for a name that no object can have.
    """
    found = sorted(path for path in folder.rglob("[!.]*") if path.is_file() and not path.is_symlink())
    for path in found:
        checked(path.relative_to(folder.parent).as_posix())
    return [_named(path.relative_to(folder).as_posix(), path) for path in found]


def _packed(folder: Path, pack: PackAnswer) -> _File:
    path = folder / pack.name
    if path.stat().st_size != pack.size_bytes:
        raise SandboxCrashedError(f"spoke of {pack.size_bytes} bytes of {pack.name}, which has {path.stat().st_size}")
    return _File(f"labels/{path.name}", "application/octet-stream", path, pack)


def _named(name: str, path: Path) -> _File:
    return _File(name, MEDIA_TYPES.get(path.suffix, "application/octet-stream"), path)


def _write_rows(publication: _Publication, session: Session) -> None:
    """Raises `JobCancelledError` when the sequence was deleted: the transaction is undone by it."""
    context = publication.context
    sequence = require_sequence(session, context.attempt)
    run = session.get_one(Job, context.attempt.root_id)
    recipe = context.arguments["recipe"]
    standing = select(LabelSet.id).where(LabelSet.sequence_id == sequence.id, LabelSet.recipe == recipe)
    label_set_id = session.scalar(standing)
    if label_set_id is None:
        label_set_id = _write_label_set(publication, session, recipe)
        ordered = sorted(publication.prepared, key=lambda pair: pair[1].sha256)  # the order in which all link
        for file, blob in ordered:
            _write_artefact(publication.told, session, label_set_id, (file, blob))
        if context.platform.settings.viewing.makes_playback:
            follow_labels(session, sequence, session.get_one(LabelSet, label_set_id), PLAYBACK)
    run.result = {"label_set_id": label_set_id, "frames": len(publication.told.tokens), "recipe": recipe}


def _write_label_set(publication: _Publication, session: Session, recipe: str) -> str:
    context, told = publication.context, publication.told
    parameters = chosen_parameters(context.arguments["profile"], context.arguments["parameters"])
    row = LabelSet(
        id=new_id(),
        sequence_id=context.attempt.sequence_id or "",
        job_id=context.attempt.root_id,
        recipe=recipe,
        parameters=asdict(parameters),
        code_version=code_version("labels"),
        frames=len(told.tokens),
        **told.totals.model_dump(),
    )
    session.add(row)
    session.flush()
    return row.id


def _write_artefact(
    told: PublicationAnswer, session: Session, label_set_id: str, stored: tuple[_File, PreparedBlob]
) -> None:
    file, blob = stored[0], link(session, stored[1])
    row = Artefact(id=new_id(), label_set_id=label_set_id, name=file.name, media_type=file.media_type)
    row.blob_sha256, row.size_bytes = blob.sha256, blob.size_bytes
    session.add(row)
    session.flush()
    if file.pack is None:
        return
    of_pack = {"label_set_id": label_set_id, "pack_id": row.id}
    rows = [
        {**of_pack, **told.frame(ordinal), "offset_bytes": offset, "length_bytes": length, "sha256": digest}
        for ordinal, (offset, length, digest) in enumerate(file.pack.ranges, start=file.pack.first)
    ]
    session.execute(insert(LabelledFrameRow), rows)
