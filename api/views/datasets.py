"""Dataset versions as response bodies, and a preview of the version that would be published.

They never include the labels of test.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from api.schemas.datasets import DatasetDetail, DatasetItem, DatasetMemberItem, DatasetPartItem
from api.schemas.grids import GridItem
from services.domain.datasets.catalogue import OPEN, entries_of
from services.domain.datasets.files import files_of
from services.domain.datasets.queries import dataset_entries, open_parts
from services.domain.datasets.splits import current_splits
from services.domain.datasets.statistics import Record
from services.domain.datasets.versions import grid_of_members, members_now, public_gap, public_statistics, refuse_low
from services.runtime.orm import Dataset, DatasetMember
from stone.errors import StoneError
from stone.splits.composition import CatalogueEntry
from stone.splits.splits import PARTS, RuleFinding


@dataclass(frozen=True)
class DatasetPreview:
    """A preview of the version to publish; `obstacle` is the reason why it cannot be published, or ''.

    `files` and `size_bytes` are those of train and val together, `warnings` the rules' warnings, `gap` the distance
    between train and test. `members` are all sequences by split, with the quality of their labels, for administrators
    only.
    """

    revision: int
    obstacle: str = ""
    statistics: Record | None = None
    files: int = 0
    size_bytes: int = 0
    warnings: tuple[RuleFinding, ...] = ()
    gap: Record | None = None
    members: Mapping[str, tuple[CatalogueEntry, ...]] = field(default_factory=dict)


def preview_of(session: Session, least_recall: float) -> DatasetPreview:
    """Return a preview of the version that `prepare_dataset` would make with that least held-out recall."""
    revision = current_splits(session).revision
    try:
        current, members, warnings = members_now(session)
        grid_of_members(members)
        refuse_low(members, least_recall)
        files = [file for part in OPEN for file in files_of(session, members[part])]
    except StoneError as error:
        return DatasetPreview(revision, str(error))
    size_bytes = sum(file.size_bytes for file in files)
    entries = {part: entries_of(labelled) for part, labelled in members.items()}
    summary = (public_statistics(members), len(files), size_bytes, warnings, public_gap(members))
    return DatasetPreview(current.revision, "", *summary, entries)


def dataset_detail(session: Session, row: Dataset) -> DatasetDetail:
    entries = dataset_entries(session, row)
    members = [
        DatasetMemberItem.of(item, split=part, daylight=item.half, **item.quality.as_record())
        for part, of_part in entries.items()
        for item in of_part
    ]
    parts = [DatasetPartItem.of(item) for item in open_parts(session, row)]
    return DatasetDetail(**dict(dataset_item(session, row)), sequences=members, parts=parts)


def dataset_item(session: Session, row: Dataset) -> DatasetItem:
    counted = select(DatasetMember.part, func.count()).where(DatasetMember.dataset_id == row.id)
    sizes = dict(session.execute(counted.group_by(DatasetMember.part)).all())
    return DatasetItem.of(row, sizes={part: sizes.get(part, 0) for part in PARTS}, grid=GridItem.recorded(row.grid))
