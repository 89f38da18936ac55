"""Imports as the API shows them: rows of `services.runtime.orm.artefacts` become bodies."""

from collections.abc import Sequence

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from api.schemas.dataset_imports import DatasetImportDetail, DatasetImportItem, ExtraFileItem
from api.schemas.jobs import JobItem
from api.schemas.sequences.recordings import PlaceItem
from api.views.jobs import job_items
from services.domain.imports.kept_files import kept_files
from services.domain.imports.requests import SCENE, progress_of
from services.runtime.orm import DatasetImport, Job
from stone_datasets.stated_layout import StatedLayout


def import_items(session: Session, rows: Sequence[DatasetImport]) -> list[DatasetImportItem]:
    """Imports as a list shows them; the runs of all, and the scenes that are done of them, are two statements."""
    ids = [row.job_id for row in rows]
    runs = job_items(session, list(session.scalars(select(Job).where(Job.id.in_(ids)))))
    of_run = {run.id: run for run in runs}
    counted = select(Job.root_id, func.count()).where(Job.root_id.in_(ids), Job.kind == SCENE, Job.state == "succeeded")
    done = {root: count for root, count in session.execute(counted.group_by(Job.root_id))}
    return [_item(row, of_run[row.job_id], done.get(row.job_id, 0)) for row in rows]


def import_detail(session: Session, row: DatasetImport) -> DatasetImportDetail:
    """Return an import with its scenes."""
    (item,) = import_items(session, [row])
    progress = progress_of(session, row)
    refused = (progress.run.result or {}).get("splits_refused")
    left_out = row.left_out or {"total": 0, "files": []}
    return DatasetImportDetail.of(
        item,
        splits_refused=refused,
        kept_files=kept_files(session, row),
        left_out=[ExtraFileItem(**file) for file in left_out["files"]],
        left_out_total=left_out["total"],
        scenes=progress.scenes,
    )


def _item(row: DatasetImport, run: JobItem, done: int) -> DatasetImportItem:
    stated = StatedLayout.of_record(row.stated)
    return DatasetImportItem.of(
        row,
        place=PlaceItem.recorded(row.place),
        classes=row.classes["name"] if row.classes else None,
        layout=stated.layout,
        grid=stated.grid.name if stated.grid else None,
        state=run.state,
        failure=run.failure,
        scenes_total=None if row.scenes is None else len(row.scenes),
        scenes_done=done,
        frames=None if row.scenes is None else sum(scene["frames"] for scene in row.scenes),
        finished_at=row.finished_ns or run.finished_at,
    )
