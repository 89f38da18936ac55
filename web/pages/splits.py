"""The splits: a board of sequences in train, val, test and none, edited by administrators, viewed by curators.

**Conventions.** The page shows the splits of the API; `modules/dataset/` sends changes to the API's own routes.
Curators see the splits of their own sequences.
"""

from dataclasses import dataclass

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse

from api.deps import Curator, PlatformDep
from api.schemas.splits import SplitEntry, SplitsAnswer
from api.views.splits import splits_answer
from api.visible import sequences_of
from services.domain.datasets.catalogue import entries_of, labelled_sequences
from services.domain.datasets.splits import current_splits, judged
from stone.splits.splits import (
    DRIVES,
    EXPOSED,
    LENGTH,
    LIGHT,
    PARTS,
    REGIONS,
    SEPARATED_PLACES,
    SHORTEST_S,
    UNSAID,
    WHOLE,
)
from stone.splits.surroundings import ENVIRONMENTS, HALVES
from web.rendering import page

router = APIRouter()
RULES = {
    WHOLE: "Whole sequences",
    DRIVES: "Whole drives",
    LENGTH: f"{SHORTEST_S:g} s or longer",
    REGIONS: "Test and train regions disjoint",
    LIGHT: "Day and night in each split",
    SEPARATED_PLACES: "Every environment in each split",
    UNSAID: "Metadata complete",
    EXPOSED: "Test not public",
}


@dataclass(frozen=True)
class Column:
    """A part of the board: its key ('' is none), how it is called, the key to press, what is in it."""

    part: str
    title: str
    key: int
    entries: list[SplitEntry]

    @property
    def drives(self) -> list[tuple[str, list[SplitEntry]]]:
        """The drives of several sequences by name, and the other sequences each with '', in the order of names."""
        groups: dict[tuple[str, str], list[SplitEntry]] = {}
        for entry in self.entries:
            groups.setdefault((entry.drive or entry.name, entry.drive), []).append(entry)
        return [(drive, entries) for (_, drive), entries in sorted(groups.items())]


@router.get("/dataset/splits")
def splits(request: Request, caller: Curator, platform: PlatformDep) -> HTMLResponse:
    with platform.database.reading() as session:
        current = current_splits(session)
        seen = labelled_sequences(session, sequences_of(caller))
    findings = judged(current.split, seen) if caller.is_administrator else None
    shown = splits_answer(current, entries_of(seen), findings)
    columns = columns_of(shown)
    others = sorted({entry.environment for entry in entries_of(seen) if entry.environment} - {*ENVIRONMENTS})
    return page(
        request,
        caller,
        "dataset/splits.html",
        splits=shown,
        columns=columns,
        gone=sum(current.split.sizes) - sum(len(column.entries) for column in columns if column.part),
        rules=RULES,
        words=(*ENVIRONMENTS, *others, *HALVES),
        can_edit=caller.is_administrator,
    )


def columns_of(shown: SplitsAnswer) -> list[Column]:
    """Return the columns train, val, test and none."""
    parts = [Column(part, part.capitalize(), key, getattr(shown, part)) for key, part in enumerate(PARTS, start=1)]
    return [*parts, Column("", "Unassigned", 0, shown.unassigned)]
