"""Reads dataset versions: their sequences, the files of their parts, the archive of a part.

**Conventions.** Files of test are never located here.
"""

from collections.abc import Mapping

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.domain.datasets.catalogue import OPEN, voxels_of
from services.domain.datasets.versions import open_entries
from services.runtime.orm import Blob, Dataset, DatasetMember, DatasetPack, DatasetPart
from services.runtime.store.pack_reading import ExportLocation
from stone.errors import Refused
from stone.splits.composition import CatalogueEntry
from stone.splits.splits import PARTS
from stone_base.label_quality import LabelQuality, pooled

Entries = Mapping[str, tuple[CatalogueEntry, ...]]


def dataset_named(session: Session, name: str) -> Dataset | None:
    return session.scalars(select(Dataset).where(Dataset.name == name)).one_or_none()


def dataset_entries(session: Session, dataset: Dataset) -> Entries:
    """Return the public entries of each part's sequences, by name."""
    of_version = select(DatasetMember).where(DatasetMember.dataset_id == dataset.id).order_by(DatasetMember.name)
    rows = session.scalars(of_version).all()
    return {part: open_entries(part, [_entry(row) for row in rows if row.part == part]) for part in PARTS}


def dataset_quality(session: Session, dataset_id: str) -> LabelQuality:
    """Return the common label quality of train and val; the quality of test is hidden."""
    of_version = select(DatasetMember).where(DatasetMember.dataset_id == dataset_id, DatasetMember.part.in_(OPEN))
    return pooled(row.quality for row in session.scalars(of_version.order_by(DatasetMember.name)))


def open_parts(session: Session, dataset: Dataset) -> tuple[DatasetPart, ...]:
    """Return the downloadable parts."""
    of_version = select(DatasetPart).where(DatasetPart.dataset_id == dataset.id, DatasetPart.part.in_(OPEN))
    rows = {row.part: row for row in session.scalars(of_version)}
    return tuple(rows[part] for part in OPEN if part in rows)


def locate_part(session: Session, dataset: Dataset, part: str) -> tuple[DatasetPart, ExportLocation]:
    """Return a part and the location of its files. Raises `hidden_part` for test and unknown parts."""
    part_row = next((row for row in open_parts(session, dataset) if row.part == part), None)
    if part_row is None:
        raise Refused("hidden_part", f"the files of {part!r} cannot be downloaded; the files of train and val can")
    packs = select(Blob.object_key).join(DatasetPack, DatasetPack.blob_sha256 == Blob.sha256)
    of_part = packs.where(DatasetPack.dataset_id == dataset.id, DatasetPack.part == part).order_by(DatasetPack.ordinal)
    index = session.get_one(Blob, part_row.index_sha256)
    return part_row, ExportLocation(index.object_key, tuple(session.scalars(of_part)))


def _entry(row: DatasetMember) -> CatalogueEntry:
    return CatalogueEntry(
        id=row.sequence_id,
        name=row.name,
        environment=row.environment,
        illumination=row.illumination,
        region=row.region,
        duration_s=row.duration_ns / 1e9,
        frames=row.frames,
        voxels=voxels_of(row.t_voxels, row.p_voxels, row.n_voxels),
        distance_m=row.distance_m,
        quality=row.quality,
        drive=row.drive,
    )
