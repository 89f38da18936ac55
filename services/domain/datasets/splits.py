"""The draft splits: labelled sequences in train, val or test until a version is published.

**Conventions.** There is one set of splits; changing it locks its row first. The rules are evaluated on every request,
since sequences are labelled, renamed and deleted meanwhile. The rules consider only sequences in the splits: the
administrator chooses the sequences of the dataset.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import delete, select
from sqlalchemy.orm import Session

from services.domain.datasets.catalogue import CatalogueSequence, entries_of
from services.runtime.database.inserts import insert_new
from services.runtime.orm import SplitMember, Splits
from services.runtime.orm.base import now_ns
from stone.splits.composition import CatalogueEntry
from stone.splits.drives import TrackGap, gap_between
from stone.splits.rules import check_split
from stone.splits.splits import PARTS, RuleFinding, Split
from stone_base.counts import counted

NAME = "dataset"
UNITS = ((86_400.0, "days"), (3600.0, "h"), (60.0, "min"))


@dataclass(frozen=True)
class CurrentSplits:
    """The current splits; revision 0 before the first change."""

    revision: int
    split: Split


def current_splits(session: Session) -> CurrentSplits:
    row = session.get(Splits, NAME)
    members = session.execute(select(SplitMember.part, SplitMember.sequence_id).order_by(SplitMember.sequence_id)).all()
    train, val, test = (tuple(sequence_id for of, sequence_id in members if of == part) for part in PARTS)
    return CurrentSplits(row.revision if row else 0, Split(train, val, test))


def lock_splits(session: Session) -> Splits:
    """Return the row of the splits, locked until the end of the transaction; create it if missing."""
    insert_new(session, Splits, [{"name": NAME, "revision": 0, "changed_ns": now_ns()}])
    locked = select(Splits).where(Splits.name == NAME).with_for_update()
    return session.scalars(locked.execution_options(populate_existing=True)).one()


def judged(split: Split, labelled: Iterable[CatalogueSequence]) -> tuple[RuleFinding, ...]:
    """Return the findings of every rule about the split."""
    named = {sequence_id for ids in split.parts.values() for sequence_id in ids}
    return check_split(split, (entry for entry in entries_of(labelled) if entry.id in named))


def gap_record(split: Split, entries: Iterable[CatalogueEntry]) -> dict[str, Any] | None:
    """Return the distance of train and test in place and time, in numbers and a sentence; None if one is empty."""
    known = {entry.id: entry for entry in entries}
    train, test = (
        {sequence_id: known[sequence_id].track for sequence_id in ids if sequence_id in known}
        for ids in (split.train, split.test)
    )
    return _gap_record(gap_between(train, test), known) if train and test else None


def _gap_record(gap: TrackGap, known: Mapping[str, CatalogueEntry]) -> dict[str, Any]:
    nearest, soonest = (
        [known[sequence_id].name for sequence_id in pair] if pair else None for pair in (gap.nearest, gap.soonest)
    )
    distance_m, time_s = (None if value is None else round(value, 3) for value in (gap.distance_m, gap.time_s))
    return {
        "distance_m": distance_m,
        "nearest": nearest,
        "time_s": time_s,
        "soonest": soonest,
        "unknown": gap.unknown,
        "message": "; ".join(_gap_words(distance_m, nearest, time_s, soonest, gap.unknown)),
    }


def _gap_words(
    distance_m: float | None, nearest: list[str] | None, time_s: float | None, soonest: list[str] | None, unknown: int
) -> Iterator[str]:
    if distance_m is None or nearest is None:
        yield "no track of train can be compared with a track of test in place"
    else:
        yield f"train and test are at least {distance_m:.0f} m apart in place ({' and '.join(nearest)})"
    if time_s is not None and soonest is not None:
        unit_s, unit = next(((size, word) for size, word in UNITS if time_s >= 2 * size), (1.0, "s"))
        yield f"at least {time_s / unit_s:.0f} {unit} apart in time ({' and '.join(soonest)})"
    if unknown:
        yield f"{counted(unknown, 'sequence')} labelled by an earlier version have no known track"


def errors_of(findings: Iterable[RuleFinding]) -> tuple[RuleFinding, ...]:
    return tuple(finding for finding in findings if finding.severity == "error")


def replace_splits(session: Session, row: Splits, split: Split) -> None:
    """Replace the draft splits with `split`, which the rules allow; `row` is locked."""
    session.execute(delete(SplitMember))
    values = [{"sequence_id": sequence_id, "part": part} for part, ids in split.parts.items() for sequence_id in ids]
    insert_new(session, SplitMember, values)
    row.revision += 1
    row.changed_ns = now_ns()
    session.flush()
