"""Dataset versions as response bodies, and a preview of the version that would be published now.

Of test's labels nothing is told.
"""

from dataclasses import dataclass

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from api.schemas.datasets import DatasetDetail, DatasetItem, DatasetMemberItem, DatasetPartItem
from services.domain.datasets.catalogue import OPEN
from services.domain.datasets.files import files_of
from services.domain.datasets.queries import dataset_entries, open_parts
from services.domain.datasets.splits import current_splits
from services.domain.datasets.statistics import Record
from services.domain.datasets.versions import members_now, told_statistics
from services.runtime.orm import Dataset, DatasetMember
from stone.errors import StoneError
from stone.splits.splits import PARTS, RuleFinding


@dataclass(frozen=True)
class DatasetPreview:
    """A version as it would be published now; `obstacle` says why it cannot be, '' where it can.

    `files` and `size_bytes` are those of train and val together, `warnings` what the rules say all the same.
    """

    revision: int
    obstacle: str = ""
    statistics: Record | None = None
    files: int = 0
    size_bytes: int = 0
    warnings: tuple[RuleFinding, ...] = ()


def prospect_of(session: Session) -> DatasetPreview:
    """A preview of the version as `prepare_dataset` would find it."""
    revision = current_splits(session).revision
    try:
        current, members, warnings = members_now(session)
        files = [file for part in OPEN for file in files_of(session, members[part])]
    except StoneError as error:
        return DatasetPreview(revision, str(error))
    size_bytes = sum(file.size_bytes for file in files)
    return DatasetPreview(current.revision, "", told_statistics(members), len(files), size_bytes, warnings)


def dataset_detail(session: Session, row: Dataset) -> DatasetDetail:
    entries = dataset_entries(session, row)
    members = [
        DatasetMemberItem.of(one, split=part, daylight=one.half) for part, of_part in entries.items() for one in of_part
    ]
    parts = [DatasetPartItem.of(one) for one in open_parts(session, row)]
    return DatasetDetail(**dict(dataset_item(session, row)), sequences=members, parts=parts)


def dataset_item(session: Session, row: Dataset) -> DatasetItem:
    counted = select(DatasetMember.part, func.count()).where(DatasetMember.dataset_id == row.id)
    sizes = dict(session.execute(counted.group_by(DatasetMember.part)).all())
    return DatasetItem.of(row, sizes={part: sizes.get(part, 0) for part in PARTS})
