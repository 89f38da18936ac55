"""The last stage: the files of the run become blobs, and rows say what they are, in the transaction of the success.

**Conventions.** Bytes first, outside any transaction; then all rows or none. Beside what is written here, every file
in the workspace's folder `map` is published under its name. A run whose sequence was deleted meanwhile writes no row
and ends cancelled.
"""

from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

from sqlalchemy import insert, select
from sqlalchemy.orm import Session

from services.labeler.comparison import comparison_path
from services.labeler.desk import Desk
from services.labeler.report import report_of
from services.labeler.results import PackIndex, load_pack, load_summaries, pack_path
from services.labeler.run import parts_of
from services.labeler.scratch import whole
from services.labeler.tables import write_frames
from services.labeler.totals import Totals, totals_of
from services.runtime.blobs import PreparedBlob, link, prepare
from services.runtime.exports import follow_labels
from services.runtime.jobs.specs import Outcome
from services.runtime.orm import Artefact, Job, LabelledFrame, LabelSet, new_id
from services.runtime.playback import PLAYBACK
from services.runtime.recipes import CODE_VERSION
from services.runtime.run_files import SEQUENCE_FILE
from services.runtime.stages import standing_sequence

REPORT, TABLE = "report.json", "frames.parquet"
DRAWN = "map"
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


def publish(desk: Desk) -> Outcome:
    """Write the report and the frame table, store all files, and answer with the rows to write."""
    desk.pull("sums", "packs", "map", comparison_path(desk.run).name)
    files = _files(desk)
    prepared = []
    for number, file in enumerate(files):
        desk.attempt.progress("publish", number, len(files))
        prepared.append((file, prepare(desk.platform.store, desk.platform.database, file.path, adopt=True)))
    desk.attempt.progress("publish", len(files), len(files))
    frames = len(desk.run.sequence.frames)
    desk.attempt.log("stored", files=len(files), size_bytes=sum(blob.size_bytes for _, blob in prepared))
    return Outcome({"frames": frames}, commit=partial(_write_rows, desk, prepared, totals_of(desk.run)))


def _files(desk: Desk) -> list[_File]:
    run, parts = desk.run, parts_of(desk.run)
    packs = [load_pack(run, part) for part in parts]
    report = report_of(run, load_summaries(run), [counts for _, counts in packs])
    out = run.scratch / "published"
    with whole(out / REPORT) as staging:
        staging.write_text(report.text())
    with whole(out / TABLE) as staging:
        write_frames(staging, run.sequence, report.counts)
    drawn = run.scratch / DRAWN
    return [
        _named(REPORT, out / REPORT),
        _named(TABLE, out / TABLE),
        _named(SEQUENCE_FILE, run.scratch / SEQUENCE_FILE),
        *(_named(path.relative_to(drawn).as_posix(), path) for path in visible_files(drawn)),
        *(
            _File(f"labels/{part[0]:06d}.pack", "application/octet-stream", pack_path(run, part), part[0], index)
            for part, (index, _) in zip(parts, packs, strict=True)
        ),
    ]


def visible_files(folder: Path) -> list[Path]:
    """Every file below the folder in the order of their names, but those that are still being written."""
    return sorted(path for path in folder.rglob("[!.]*") if path.is_file())


def _named(name: str, path: Path) -> _File:
    return _File(name, MEDIA_TYPES.get(path.suffix, "application/octet-stream"), path)


def _write_rows(desk: Desk, prepared: list[tuple[_File, PreparedBlob]], totals: Totals, session: Session) -> None:
    """Raises `JobCancelledError` when the sequence was deleted: the transaction is undone by it."""
    sequence = standing_sequence(session, desk.attempt)
    run = session.get_one(Job, desk.attempt.root_id)
    recipe = desk.arguments["recipe"]
    standing = select(LabelSet.id).where(LabelSet.sequence_id == sequence.id, LabelSet.recipe == recipe)
    label_set_id = session.scalar(standing)
    if label_set_id is None:
        label_set_id = _write_label_set(desk, session, recipe, totals)
        for file, blob in sorted(prepared, key=lambda pair: pair[1].sha256):  # the order in which all link
            _write_artefact(desk, session, label_set_id, (file, blob))
        if desk.platform.settings.viewing.makes_playback:
            follow_labels(session, sequence, session.get_one(LabelSet, label_set_id), PLAYBACK)
    run.result = {"label_set_id": label_set_id, "frames": len(desk.run.sequence.frames), "recipe": recipe}


def _write_label_set(desk: Desk, session: Session, recipe: str, totals: Totals) -> str:
    row = LabelSet(
        id=new_id(),
        sequence_id=desk.attempt.sequence_id or "",
        job_id=desk.attempt.root_id,
        recipe=recipe,
        parameters=asdict(desk.run.parameters),
        code_version=CODE_VERSION,
        frames=len(desk.run.sequence.frames),
        **totals,
    )
    session.add(row)
    session.flush()
    return row.id


def _write_artefact(desk: Desk, session: Session, label_set_id: str, stored: tuple[_File, PreparedBlob]) -> None:
    file, blob = stored[0], link(session, stored[1])
    row = Artefact(id=new_id(), label_set_id=label_set_id, name=file.name, media_type=file.media_type)
    row.blob_sha256, row.size_bytes = blob.sha256, blob.size_bytes
    session.add(row)
    session.flush()
    if file.index is None or file.first is None:
        return
    frames = desk.run.sequence.frames
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
    session.execute(insert(LabelledFrame), rows)
