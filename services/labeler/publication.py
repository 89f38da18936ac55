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
from services.domain.sequences.run_files import SEQUENCE_FILE
from services.domain.sequences.stage_checks import require_sequence
from services.domain.viewer.playback import PLAYBACK
from services.labeler.map.comparison import comparison_path
from services.labeler.map.map_files import map_folder
from services.labeler.map.track_coverage import coverage_path
from services.labeler.report import report_of
from services.labeler.results import PackIndex, load_pack, pack_path
from services.labeler.run import LabelRun, Part, parts_of
from services.labeler.scratch import whole
from services.labeler.stage import StageFiles
from services.labeler.stage_context import LabelStageContext
from services.labeler.tables import write_frames
from services.labeler.totals import Totals, totals_of
from services.runtime.code_version import code_version
from services.runtime.jobs.specs import Outcome
from services.runtime.orm import Artefact, Job, LabelledFrameRow, LabelSet, new_id
from services.runtime.store.blobs import PreparedBlob, link, prepare

REPORT, TABLE = "report.json", "frames.parquet"
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


@dataclass(frozen=True)
class _File:
    """A file to publish; `name` is its artefact's. A pack begins with the frame of this ordinal."""

    name: str
    media_type: str
    path: Path
    first: int | None = None
    index: PackIndex | None = None


def publish(context: LabelStageContext) -> Outcome:
    """Write the report and the frame table, store all files, and answer with the rows to write."""
    context.pull(files_of_publish(context.run))
    files = _files(context)
    prepared = []
    for number, file in enumerate(files):
        context.attempt.progress("publish", number, len(files))
        prepared.append((file, prepare(context.platform.store, context.platform.database, file.path, adopt=True)))
    context.attempt.progress("publish", len(files), len(files))
    frames = len(context.run.sequence.frames)
    context.attempt.log("stored", files=len(files), size_bytes=sum(blob.size_bytes for _, blob in prepared))
    return Outcome({"frames": frames}, commit=partial(_write_rows, context, prepared, totals_of(context.run)))


def files_of_publish(run: LabelRun) -> StageFiles:
    """What it pulls: all that is published, and what the report is made of."""
    needed = ("sums", "packs", "far", map_folder(run).name, comparison_path(run).name, coverage_path(run).name)
    return StageFiles(needed, needed)


def _files(context: LabelStageContext) -> list[_File]:
    run, report = context.run, report_of(context.run)
    out = run.scratch / "published"
    with whole(out / REPORT) as staging:
        staging.write_text(report.text())
    with whole(out / TABLE) as staging:
        write_frames(staging, run.sequence, report.counts)
    drawn = map_folder(run)
    return [
        _named(REPORT, out / REPORT),
        _named(TABLE, out / TABLE),
        _named(SEQUENCE_FILE, run.scratch / SEQUENCE_FILE),
        *(_named(path.relative_to(drawn).as_posix(), path) for path in visible_files(drawn)),
        *(_packed(run, part) for part in parts_of(run)),
    ]


def visible_files(folder: Path) -> list[Path]:
    """Every file below the folder in the order of their names, but those that are still being written."""
    return sorted(path for path in folder.rglob("[!.]*") if path.is_file())


def _packed(run: LabelRun, part: Part) -> _File:
    path = pack_path(run, part)
    return _File(f"labels/{path.name}", "application/octet-stream", path, part[0], load_pack(run, part)[0])


def _named(name: str, path: Path) -> _File:
    return _File(name, MEDIA_TYPES.get(path.suffix, "application/octet-stream"), path)


def _write_rows(
    context: LabelStageContext, prepared: list[tuple[_File, PreparedBlob]], totals: Totals, session: Session
) -> None:
    """Raises `JobCancelledError` when the sequence was deleted: the transaction is undone by it."""
    sequence = require_sequence(session, context.attempt)
    run = session.get_one(Job, context.attempt.root_id)
    recipe = context.arguments["recipe"]
    standing = select(LabelSet.id).where(LabelSet.sequence_id == sequence.id, LabelSet.recipe == recipe)
    label_set_id = session.scalar(standing)
    if label_set_id is None:
        label_set_id = _write_label_set(context, session, recipe, totals)
        for file, blob in sorted(prepared, key=lambda pair: pair[1].sha256):  # the order in which all link
            _write_artefact(context, session, label_set_id, (file, blob))
        if context.platform.settings.viewing.makes_playback:
            follow_labels(session, sequence, session.get_one(LabelSet, label_set_id), PLAYBACK)
    run.result = {"label_set_id": label_set_id, "frames": len(context.run.sequence.frames), "recipe": recipe}


def _write_label_set(context: LabelStageContext, session: Session, recipe: str, totals: Totals) -> str:
    row = LabelSet(
        id=new_id(),
        sequence_id=context.attempt.sequence_id or "",
        job_id=context.attempt.root_id,
        recipe=recipe,
        parameters=asdict(context.run.parameters),
        code_version=code_version("labels"),
        frames=len(context.run.sequence.frames),
        **totals,
    )
    session.add(row)
    session.flush()
    return row.id


def _write_artefact(
    context: LabelStageContext, session: Session, label_set_id: str, stored: tuple[_File, PreparedBlob]
) -> None:
    file, blob = stored[0], link(session, stored[1])
    row = Artefact(id=new_id(), label_set_id=label_set_id, name=file.name, media_type=file.media_type)
    row.blob_sha256, row.size_bytes = blob.sha256, blob.size_bytes
    session.add(row)
    session.flush()
    if file.index is None or file.first is None:
        return
    frames = context.run.sequence.frames
    rows = [
        {
            "label_set_id": label_set_id,
            "ordinal": ordinal,
            "token": frames.tokens[ordinal],
            "stamp_ns": int(frames.stamps_ns[ordinal]),
            "pack_id": row.id,
            "offset_bytes": offset,
            "length_bytes": length,
            "sha256": digest,
        }
        for ordinal, (offset, length, digest) in enumerate(file.index.ranges(), start=file.first)
    ]
    session.execute(insert(LabelledFrameRow), rows)
