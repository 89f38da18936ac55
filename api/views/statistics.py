"""The dataset statistics record, shared by the API's JSON and the pages' figures."""

from sqlalchemy.orm import Session

from api.deps import Caller
from api.visible import dataset_of, sequences_of
from services.domain.datasets.catalogue import entries_of, labelled_sequences
from services.domain.datasets.queries import dataset_entries
from services.domain.datasets.splits import current_splits
from services.domain.datasets.statistics import Record, statistics_record
from stone.splits.composition import CatalogueEntry


def composition_record(session: Session, caller: Caller, dataset: str | None) -> Record:
    """Return the composition of the version of that name, else of the caller's labelled sequences. Raises
    `NotFoundError`.
    """
    if dataset is not None:
        return statistics_record(dataset_entries(session, dataset_of(session, dataset)))
    seen = entries_of(labelled_sequences(session, sequences_of(caller)))
    split = current_splits(session).split
    assigned: dict[str, list[CatalogueEntry]] = {
        part: [entry for entry in seen if entry.id in ids] for part, ids in split.parts.items()
    }
    of_part = {entry.id for entries in assigned.values() for entry in entries}
    return statistics_record({**assigned, "": [entry for entry in seen if entry.id not in of_part]})
