"""Versions of the dataset: published once from the draft splits, and never changed.

**Conventions.** Slow work (indexes, digests) is done before the transaction, which fails if the splits changed
meanwhile. Foreign keys hold all blobs of a version, including the labels of test, which are never served.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from sqlalchemy import insert, select
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from services.domain.datasets.catalogue import HIDDEN, OPEN, CatalogueSequence, entries_of, labelled_sequences
from services.domain.datasets.files import DatasetFile, files_of, packed, sums_file, sums_of
from services.domain.datasets.splits import (
    CurrentSplits,
    current_splits,
    errors_of,
    gap_record,
    judged,
    lock_splits,
)
from services.domain.datasets.statistics import CLASSES, statistics_record
from services.runtime.access.errors import name_taken
from services.runtime.code_version import code_version
from services.runtime.orm import Blob, Dataset, DatasetMember, DatasetPack, DatasetPart, new_id
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.store.blobs import PreparedBlob, link_all, prepare
from services.runtime.store.faults import refuse_damaged
from services.runtime.store.pack_reading import StoredFiles, archive_sha256
from services.runtime.store.packs import PackedFiles, index_bytes
from stone.errors import Refused
from stone.splits.composition import CatalogueEntry
from stone.splits.splits import PARTS, RuleFinding, Split
from stone.splits.surroundings import DAYLIGHT, UNSAID
from stone_base.counts import counted
from stone_base.label_grid import PAPER, LabelGrid, record_unless_paper, recorded_grid
from stone_base.label_quality import UNKNOWN

# The manifest of a dataset version: its contents in one JSON file whose sha256 identifies it. It lists the files of
# train and val. For test it lists only sequences and their conditions, and nothing derived from their labels: no file,
# no digest, no count; `statistics` contain the voxels of train and val only.


FORMAT = 1

Members = Mapping[str, tuple[CatalogueSequence, ...]]


@dataclass(frozen=True)
class NewDataset:
    """A dataset version to publish; `name` is the version's name."""

    name: str
    licence: str
    user_id: str


def manifest_bytes(
    new: NewDataset, created_ns: int, members: Members, files: Mapping[str, tuple[DatasetFile, ...]]
) -> bytes:
    """Return the manifest as a file; `files` are the files of the open parts."""
    record = {
        "stone_dataset": FORMAT,
        "version": new.name,
        "licence": new.licence,
        "created_ns": created_ns,
        "code_version": code_version("labels"),
        "splits": {part: [member.sequence.name for member in labelled] for part, labelled in members.items()},
        "sequences": [_describe_sequence(member, part) for part, labelled in members.items() for member in labelled],
        "statistics": public_statistics(members),
        "grid": grid_of_members(members).as_record(),
        "gap": public_gap(members),
        "files": {part: [file.as_record() for file in of_part] for part, of_part in files.items()},
    }
    return (json.dumps(record, sort_keys=True, ensure_ascii=False, allow_nan=False) + "\n").encode()


def public_statistics(members: Members) -> dict[str, Any]:
    """Return the statistics of all parts, with voxels only of the open parts."""
    return statistics_record({part: open_entries(part, entries_of(labelled)) for part, labelled in members.items()})


def public_gap(members: Members) -> dict[str, Any] | None:
    """Return the gap between train and test, as `gap_record`."""
    entries = {part: entries_of(labelled) for part, labelled in members.items()}
    every = tuple(entry for of_part in entries.values() for entry in of_part)
    split = Split(**{part: tuple(entry.id for entry in of_part) for part, of_part in entries.items()})
    return gap_record(split, every)


def open_entries(part: str, entries: Iterable[CatalogueEntry]) -> tuple[CatalogueEntry, ...]:
    """Return the public entries of a part: entries of test lack voxels and quality."""
    return tuple(replace(entry, voxels=None, quality=UNKNOWN) if part == HIDDEN else entry for entry in entries)


def _describe_sequence(labelled: CatalogueSequence, part: str) -> dict[str, Any]:
    """Return the public record of a sequence; for an open part with the recipe and totals of its labels."""
    entry = labelled.entry
    record = {
        "name": entry.name,
        "split": part,
        "environment": entry.environment,
        "illumination": entry.illumination,
        "daylight": DAYLIGHT.get(entry.illumination, UNSAID),
        "region": entry.region,
        "drive": entry.drive,
        "frames": entry.frames,
        "duration_s": entry.duration_s,
        "distance_m": entry.distance_m,
    }
    if part == HIDDEN:
        return record
    voxels = dict(zip(CLASSES, entry.voxels, strict=True)) if entry.voxels is not None else None
    label_set = {"id": labelled.labels.id, "recipe": labelled.labels.recipe, "quality": entry.quality.as_record()}
    return {**record, "label_set": label_set, "voxels": voxels}


def grid_of_members(members: Members) -> LabelGrid:
    """Return the one grid of all labels of a version. Raises `mixed_grids`."""
    named = {recorded_grid(member.labels.grid): member for labelled in members.values() for member in labelled}
    if len(named) > 1:
        examples = "; ".join(f"{member.entry.name} has {grid}" for grid, member in list(named.items())[:3])
        raise Refused(
            "mixed_grids",
            f"the label sets in the splits have {len(named)} different grids: {examples}. A version has exactly one "
            "grid; process the sequences again with one grid, or remove them from the splits",
        )
    return next(iter(named), PAPER)


@dataclass(frozen=True, eq=False)
class PreparedPart:
    """A part whose index and checksums are stored.

    It has the files, the blobs that contain them and, if the part is open, size and sha256 of its tar.
    """

    files: tuple[DatasetFile, ...]
    index: PreparedBlob
    sums: PreparedBlob
    packs: tuple[str, ...]
    tar: tuple[int, str]


@dataclass(frozen=True, eq=False)
class PreparedDataset:
    """A version that is complete except for its rows."""

    new: NewDataset
    revision: int
    created_ns: int
    members: Members
    manifest: PreparedBlob
    parts: Mapping[str, PreparedPart]
    warnings: tuple[RuleFinding, ...] = ()


def prepare_dataset(platform: Platform, new: NewDataset, folder: Path) -> PreparedDataset:
    """Prepare a version except for its rows; its own files are written to `folder`.

    Raises `no_splits`, `splits_broken`, `mixed_grids`, `held_out_low`, `bad_member`, `name_taken`, `StoreFullError`.
    """
    with platform.database.reading() as session:
        if session.scalar(select(Dataset.id).where(Dataset.name == new.name)) is not None:
            raise name_taken("dataset version", new.name)
        current, members, warnings = members_now(session)
    grid_of_members(members)
    refuse_low(members, platform.settings.publishing.least_held_out_recall)
    return replace(assembled(platform, new, folder, (current.revision, members)), warnings=warnings)


def assembled(platform: Platform, new: NewDataset, folder: Path, splits: tuple[int, Members]) -> PreparedDataset:
    """Return a version of these members of the splits at that revision. Raises `bad_member`, `StoreFullError`."""
    created_ns, (revision, members) = now_ns(), splits
    with platform.database.reading() as session:
        files = {part: files_of(session, labelled) for part, labelled in members.items()}
    parts: dict[str, PreparedPart] = {part: _prepared_part(platform, folder, part, files[part]) for part in PARTS}
    manifest = manifest_bytes(new, created_ns, members, {part: parts[part].files for part in OPEN})
    blob = _stored(platform, folder / "manifest.json", manifest)
    return PreparedDataset(new, revision, created_ns, members, blob, parts)


def write_dataset(session: Session, prepared: PreparedDataset) -> Dataset:
    """Write the rows of the version. Raises `splits_changed`, `name_taken`."""
    row = lock_splits(session)
    if row.revision != prepared.revision:
        raise Refused(
            "splits_changed",
            f"the splits changed meanwhile from revision {prepared.revision} to {row.revision}; review them and "
            "publish again",
        )
    parts = prepared.parts.items()
    own = (blob for _, part in parts for blob in (part.index, part.sums))
    link_all(session, (prepared.manifest, *own))
    dataset = Dataset(
        id=new_id(),
        name=prepared.new.name,
        licence=prepared.new.licence,
        code_version=code_version("labels"),
        manifest_sha256=prepared.manifest.sha256,
        manifest_bytes=prepared.manifest.size_bytes,
        grid=record_unless_paper(grid_of_members(prepared.members)),
        created_by=prepared.new.user_id,
        created_ns=prepared.created_ns,
    )
    session.add(dataset)
    try:
        session.flush()
    except IntegrityError:
        raise name_taken("dataset version", dataset.name) from None
    _write_members(session, dataset.id, prepared.members)
    for part, made in parts:
        _write_part(session, dataset.id, part, made)
    return dataset


def members_now(session: Session) -> tuple[CurrentSplits, Members, tuple[RuleFinding, ...]]:
    """Return the current splits, the sequences of each part, and the warnings of the rules.

    Raises `no_splits`, `splits_broken`.
    """
    current = current_splits(session)
    if not current.split.filled:
        raise Refused("no_splits", "no sequence is in train, val or test; save the splits first (PUT /splits)")
    labelled = labelled_sequences(session)
    findings = judged(current.split, labelled)
    if broken := errors_of(findings):
        raise broken_splits([finding.message for finding in broken])
    parts = current.split.parts
    members: Members = {part: tuple(member for member in labelled if member.entry.id in parts[part]) for part in PARTS}
    return current, members, findings


def refuse_low(members: Members, least_recall: float) -> None:
    """Raise `held_out_low` if the held-out recall of a label set is unknown or below the limit; 0 is no limit."""
    entries = [member.entry for labelled in members.values() for member in labelled]
    low = [member for member in entries if (member.quality.held_out_recall or 0.0) < least_recall]
    if low:
        raise Refused(
            "held_out_low",
            f"the held-out recall of {counted(len(low), 'label set')} is below the limit of {least_recall:.2%}: "
            f"{_first([_recall(member) for member in low])}. Process these sequences again or remove them from the "
            "splits. The setting STONE_PUBLISHING__LEAST_HELD_OUT_RECALL is the limit (0: no limit)",
        )


def _recall(entry: CatalogueEntry) -> str:
    recall = entry.quality.held_out_recall
    return f"{entry.name} has {recall:.2%}" if recall is not None else f"{entry.name} has no held-out recall"


def _first(sentences: Sequence[str]) -> str:
    more = f"; and {len(sentences) - 3} more" if len(sentences) > 3 else ""
    return "; ".join(sentences[:3]) + more


def _prepared_part(platform: Platform, folder: Path, part: str, files: tuple[DatasetFile, ...]) -> PreparedPart:
    """Return the part with its checksums. Raises `ObjectMissingError` if a file was deleted meanwhile."""
    content = sums_of(files)
    sums = _stored(platform, folder / f"{part}.txt", content)
    listed = (*files, sums_file(content))
    index, packs = packed(listed)
    tar = _tar(platform, index, packs, sums) if part in OPEN else (0, "")
    return PreparedPart(listed, _stored(platform, folder / f"{part}.npz", index_bytes(index)), sums, packs, tar)


def _tar(platform: Platform, index: PackedFiles, packs: tuple[str, ...], sums: PreparedBlob) -> tuple[int, str]:
    """Return size and sha256 of the tar, which is read once completely; the checksum file may have no row yet."""
    with platform.database.reading() as session:
        rows = (session.get(Blob, blob) for blob in packs)
        keys = tuple(row.object_key if row is not None else sums.object_key for row in rows)
    # The hash must not cover damaged files.
    refuse_damaged(platform.store, platform.database, keys, "a file of the labels")
    stored = StoredFiles(index, keys)
    return archive_sha256(index, "tar", stored.reader(platform.store), lambda _done, _total: None)


def _stored(platform: Platform, path: Path, content: bytes) -> PreparedBlob:
    path.write_bytes(content)
    return prepare(platform.store, platform.database, path, adopt=True)


def _write_members(session: Session, dataset_id: str, members: Members) -> None:
    for part, labelled in members.items():
        for member in labelled:
            entry, labels = member.entry, member.labels
            row = DatasetMember(dataset_id=dataset_id, sequence_id=entry.id, label_set_id=labels.id, part=part)
            row.name, row.recipe = entry.name, labels.recipe
            row.environment, row.illumination, row.region = entry.environment, entry.illumination, entry.region
            row.drive, row.first_stamp_ns = entry.drive, entry.track.first_ns if entry.track else None
            row.frames, row.duration_ns, row.distance_m = entry.frames, labels.duration_ns or 0, entry.distance_m
            row.t_voxels, row.p_voxels, row.n_voxels = entry.voxels or (None, None, None)
            row.held_out_recall, row.held_out_m = labels.held_out_recall, labels.held_out_m
            row.gravest_code, row.gravest_severity = labels.gravest_code, labels.gravest_severity
            session.add(row)
    session.flush()


def _write_part(session: Session, dataset_id: str, part: str, made: PreparedPart) -> None:
    size_bytes = sum(file.size_bytes for file in made.files)
    row = DatasetPart(dataset_id=dataset_id, part=part, files=len(made.files), size_bytes=size_bytes)
    row.index_sha256 = made.index.sha256
    row.tar_bytes, row.tar_sha256 = made.tar
    session.add(row)
    session.flush()
    held = [
        {"dataset_id": dataset_id, "part": part, "ordinal": ordinal, "blob_sha256": blob}
        for ordinal, blob in enumerate(made.packs)
    ]
    session.execute(insert(DatasetPack), held)


def broken_splits(sentences: Sequence[str]) -> Refused:
    return Refused("splits_broken", f"the splits break {len(sentences)} rule(s): {_first(sentences)}")
