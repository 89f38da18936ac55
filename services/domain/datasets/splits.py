"""The draft splits: which labelled sequence is in train, val or test until a version is published.

**Conventions.** There is one set of splits; whoever changes it locks its row first. What the rules say of it is found
anew each time, since sequences are labelled, renamed and deleted meanwhile. The data of the rules are the sequences
that the splits name: which ones make up the dataset is the administrator's choice.
"""

from collections.abc import Iterable
from dataclasses import dataclass

from sqlalchemy import delete, select
from sqlalchemy.orm import Session

from services.domain.datasets.catalogue import CatalogueSequence, entries_of
from services.runtime.database.inserts import insert_new
from services.runtime.orm import SplitMember, Splits
from services.runtime.orm.base import now_ns
from stone.splits.rules import check_split
from stone.splits.splits import PARTS, RuleFinding, Split

NAME = "dataset"


@dataclass(frozen=True)
class CurrentSplits:
    """The splits as they stand; revision 0 before the first change."""

    revision: int
    split: Split


def current_splits(session: Session) -> CurrentSplits:
    row = session.get(Splits, NAME)
    members = session.execute(select(SplitMember.part, SplitMember.sequence_id).order_by(SplitMember.sequence_id)).all()
    train, val, test = (tuple(one for of, one in members if of == part) for part in PARTS)
    return CurrentSplits(row.revision if row else 0, Split(train, val, test))


def lock_splits(session: Session) -> Splits:
    """The row of the splits, locked until the end of the transaction; made where there is none."""
    insert_new(session, Splits, [{"name": NAME, "revision": 0, "changed_ns": now_ns()}])
    locked = select(Splits).where(Splits.name == NAME).with_for_update()
    return session.scalars(locked.execution_options(populate_existing=True)).one()


def judged(split: Split, labelled: Iterable[CatalogueSequence]) -> tuple[RuleFinding, ...]:
    """The findings of every rule about the split."""
    named = {one for ids in split.parts.values() for one in ids}
    return check_split(split, (entry for entry in entries_of(labelled) if entry.id in named))


def errors_of(findings: Iterable[RuleFinding]) -> tuple[RuleFinding, ...]:
    return tuple(finding for finding in findings if finding.severity == "error")


def replace_splits(session: Session, row: Splits, split: Split) -> None:
    """Make `split`, which the rules let pass, the one under discussion; `row` is locked."""
    session.execute(delete(SplitMember))
    values = [{"sequence_id": one, "part": part} for part, ids in split.parts.items() for one in ids]
    insert_new(session, SplitMember, values)
    row.revision += 1
    row.changed_ns = now_ns()
    session.flush()
