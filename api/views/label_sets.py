"""Label sets and their comparisons as response bodies, and pictures of where two of them differ."""

from collections.abc import Sequence as Listing
from functools import lru_cache

from sqlalchemy import select
from sqlalchemy.orm import Session

from api.schemas.grids import GridItem
from api.schemas.sequences.label_sets import LabelComparisonItem, LabelSetItem
from api.views.jobs import coded_failure
from services.domain.exports.requests import counting_labels
from services.domain.sequences.label_comparisons import StoredLabelFile, StoredPair
from services.domain.viewer.formats import difference_bytes, voxels_bytes
from services.domain.viewer.frame_grids import stored_grids
from services.domain.viewer.frame_picture import SeenGrid, comparison_picture, recoloured
from services.runtime.orm import Job, LabelComparison, LabelSet
from services.runtime.store.protocol import Store
from stone.labels.class_colours import ColourName
from stone.scoring.agreement import differences

HELD_PICTURES = 64


def label_set_items(session: Session, sequence_id: str, rows: Listing[LabelSet]) -> list[LabelSetItem]:
    """Label sets of one sequence as a list shows them."""
    counting = counting_labels(session, sequence_id)
    return [
        LabelSetItem.of(
            row,
            **row.quality.as_record(),
            profile=str(row.parameters.get("profile", "")),
            is_counting=counting is not None and row.id == counting.id,
            grid=GridItem.recorded(row.grid),
        )
        for row in rows
    ]


def comparison_items(session: Session, rows: Listing[LabelComparison]) -> list[LabelComparisonItem]:
    """Return comparisons as a list shows them."""
    jobs = {job.id: job for job in session.scalars(select(Job).where(Job.id.in_([row.job_id for row in rows])))}
    return [_item(row, jobs[row.job_id]) for row in rows]


def pair_picture(store: Store, pair: StoredPair, colours: ColourName) -> bytes:
    """Return A, B and the difference from above as a PNG. Raises `grid_unreadable`."""
    return recoloured(_picture(store, pair), colours)


def pair_differences(store: Store, pair: StoredPair) -> bytes:
    """Return `STD1` of the differences between A and B. Raises `grid_unreadable`."""
    return _differences(store, pair)


@lru_cache(maxsize=HELD_PICTURES)
def frame_voxels_of(store: Store, file: StoredLabelFile) -> bytes:
    """Return `STV1` of a frame of any label set. Raises `grid_unreadable`."""
    return voxels_bytes(*stored_grids(store, file.object_key, file.span))


@lru_cache(maxsize=HELD_PICTURES)
def _differences(store: Store, pair: StoredPair) -> bytes:
    return difference_bytes(differences(_grids(store, pair.a)[0], _grids(store, pair.b)[0]))


@lru_cache(maxsize=HELD_PICTURES)
def _picture(store: Store, pair: StoredPair) -> bytes:
    return comparison_picture(_grids(store, pair.a), _grids(store, pair.b))


def _grids(store: Store, file: StoredLabelFile) -> SeenGrid:
    return stored_grids(store, file.object_key, file.span)


def _item(row: LabelComparison, job: Job) -> LabelComparisonItem:
    state = "succeeded" if row.finished_ns is not None else job.state
    return LabelComparisonItem.of(row, state=state, failure=coded_failure(job))
