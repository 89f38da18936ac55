"""The publish stage: stores the files of a run as blobs and writes the rows of the label set.

**Conventions.** Bytes first, outside any transaction; then all rows or none. Besides the files written here, every file
in the workspace's folder `map` is published under its name. The sequence published is that of the late checks, which
this stage needs. A run whose sequence was deleted meanwhile writes no row and ends cancelled.
"""

from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

from sqlalchemy.orm import Session

from services.domain.exports.requests import follow_labels
from services.domain.sequences.chosen_recordings import recording_ids_of
from services.domain.sequences.run_files import CHECKED_FILE, SEQUENCE_FILE
from services.domain.sequences.stage_checks import require_sequence
from services.domain.viewer.playback import PLAYBACK
from services.labeler.child_answers import PublicationAnswer
from services.labeler.exports.source import REPORT, TABLE
from services.labeler.label_rows import NewArtefact, NewLabelSet, standing_label_set, write_artefact, write_label_set
from services.labeler.left_files import LeftFile, files_left, left_file, pack_left
from services.labeler.map.comparison import COMPARISON
from services.labeler.map.far_points import FAR
from services.labeler.map.map_files import MAP
from services.labeler.map.track_coverage import COVERAGE
from services.labeler.parameters import chosen_parameters
from services.labeler.publication_files import PUBLISHED
from services.labeler.run_workspace import LabelStageContext
from services.labeler.sandboxed_run import described
from services.runtime.access import storage_quota
from services.runtime.jobs.specs import Outcome
from services.runtime.orm import Job, LabelSet
from services.runtime.store.blobs import PreparedBlob, link_all, prepare_all
from stone_base.label_grid import recorded_grid
from stone_files.grid_file import GRID_FILE
from stone_files.joined_file import JOINED

NEEDED = (CHECKED_FILE, "sums", "packs", FAR, MAP, COMPARISON, COVERAGE)


@dataclass(frozen=True)
class _Publication:
    """The rows of one transaction: stored files, and a child's facts about them."""

    context: LabelStageContext
    prepared: list[tuple[LeftFile, PreparedBlob]]
    answer: PublicationAnswer


def publish(context: LabelStageContext) -> Outcome:
    """Write the report and the frame table, store all files, and return the rows to write.

    Raises what `LabelStageContext.ask` raises, and `SandboxCrashedError` for packs shorter than reported.
    """
    context.pull(NEEDED, NEEDED)
    opening = replace(context.opening, sequence_file=CHECKED_FILE)
    answer = context.ask(PublicationAnswer, partial(described, opening), "publish", opening)
    files, prepared = _files(context, answer), list[tuple[LeftFile, PreparedBlob]]()
    context.attempt.progress("publish", 0, len(files))
    stored = prepare_all(context.platform.store, context.platform.database, [file.path for file in files], adopt=True)
    for file, blob in zip(files, stored, strict=True):
        prepared.append((file, blob))
        context.attempt.progress("publish", len(prepared), len(files))
    context.attempt.log("stored", files=len(files), size_bytes=sum(blob.size_bytes for _, blob in prepared))
    rows = _Publication(context, prepared, answer)
    return Outcome({"frames": len(answer.tokens)}, commit=partial(_write_rows, rows))


def _files(context: LabelStageContext, answer: PublicationAnswer) -> list[LeftFile]:
    folder, is_joined = context.workspace.folder, len(recording_ids_of(context.arguments)) > 1
    return [
        left_file(REPORT, folder / PUBLISHED / REPORT),
        left_file(TABLE, folder / PUBLISHED / TABLE),
        left_file(GRID_FILE, folder / PUBLISHED / GRID_FILE),
        left_file(SEQUENCE_FILE, folder / CHECKED_FILE),
        *([left_file(JOINED, folder / JOINED)] if is_joined else []),
        *files_left(folder / MAP),
        *(pack_left(folder / pack.name, pack) for pack in answer.packs),
    ]


def _write_rows(publication: _Publication, session: Session) -> None:
    """Write the rows. Raises `JobCancelledError` if the sequence was deleted, and `quota_exceeded`; both roll back."""
    context = publication.context
    sequence = require_sequence(session, context.attempt)
    run = session.get_one(Job, context.attempt.root_id)
    recipe = context.arguments["recipe"]
    labels = standing_label_set(session, sequence.id, recipe)
    if labels is None:
        labels = _write_labels(publication, session, _new_label_set(context, sequence.id, run.id))
        size_bytes = sum(prepared.size_bytes for _, prepared in publication.prepared)
        limit_bytes = context.platform.settings.uploads.owner_bytes
        storage_quota.reserve(session, sequence.owner_id, size_bytes, labels.id, "label set", limit_bytes)
        if context.platform.settings.viewing.makes_playback:
            follow_labels(session, sequence, labels, PLAYBACK)
    run.result = {"label_set_id": labels.id, "frames": len(publication.answer.tokens), "recipe": recipe}


def _write_labels(publication: _Publication, session: Session, new: NewLabelSet) -> LabelSet:
    labels = write_label_set(session, new, publication.answer)
    blobs = link_all(session, [prepared for _, prepared in publication.prepared])
    for file, prepared in publication.prepared:
        blob = blobs[prepared.sha256]
        stored = NewArtefact(file.name, file.media_type, blob.sha256, blob.size_bytes, file.pack)
        write_artefact(session, labels.id, stored, publication.answer)
    return labels


def _new_label_set(context: LabelStageContext, sequence_id: str, run_id: str) -> NewLabelSet:
    grid = context.arguments.get("grid")
    return NewLabelSet(sequence_id, run_id, context.arguments["recipe"], _parameters(context), grid=grid)


def _parameters(context: LabelStageContext) -> dict[str, Any]:
    grid = recorded_grid(context.arguments.get("grid"))
    return asdict(chosen_parameters(context.arguments["profile"], context.arguments["parameters"], (grid,)))
