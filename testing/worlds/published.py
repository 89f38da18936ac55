"""Versions of the dataset that exist before a route is called, created without changing the draft splits."""

from collections.abc import Mapping
from pathlib import Path

from services.domain.datasets.catalogue import CatalogueSequence, labelled_sequences
from services.domain.datasets.splits import current_splits
from services.domain.datasets.versions import NewDataset, assembled, write_dataset
from services.runtime.orm import SequenceRow, new_id
from services.runtime.platform import Platform
from stone.splits.splits import PARTS
from testing.worlds import made


def dataset(platform: Platform, user_id: str, parts: Mapping[str, list[str]], name: str = "") -> str:
    """Create a version with the sequences of these ids in these parts; return its name."""
    folder = Path(platform.settings.root) / f"made-{new_id()}"
    folder.mkdir(parents=True)
    with platform.database.reading() as session:
        revision, labelled = current_splits(session).revision, labelled_sequences(session)
    members: dict[str, tuple[CatalogueSequence, ...]] = {
        part: tuple(sequence for sequence in labelled if sequence.entry.id in parts.get(part, ())) for part in PARTS
    }
    new = NewDataset(name or f"v-{new_id()[-8:]}", "CC0", user_id)
    prepared = assembled(platform, new, folder, (revision, members))
    with platform.database.transaction() as session:
        return write_dataset(session, prepared).name


def published_sequence(platform: Platform, owner_id: str, **said: str) -> str:
    """Create a labelled sequence with unique labels; return its id."""
    with platform.database.transaction() as session:
        row = SequenceRow(owner_id=owner_id, name=f"open-{new_id()[-8:]}", **said)
        session.add(row)
        session.flush()
        facts = {"id": row.id, "name": row.name, "owner_id": owner_id}
    made.labels(platform, facts, seed=row.id.encode())
    return row.id
