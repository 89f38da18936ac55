"""Results published elsewhere and ceilings, added by an administrator: on the leaderboard, marked, never ranked.

**Conventions.** The list of a phase is replaced as a whole. Method and modality identify a row; an unchanged row keeps
its id. A published result is on the track of its modality; a ceiling concerns the labels and is therefore on every
track.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from typing import Literal, get_args

from sqlalchemy import BindParameter, ColumnElement, or_, select
from sqlalchemy.orm import Session

from services.domain.benchmarks.phases.phases import lock_phase
from services.domain.benchmarks.visibility import PERCENT_DIGITS
from services.runtime.orm import Phase, Reported
from stone.errors import Refused

ReportedKind = Literal["published", "ceiling"]
KINDS: tuple[ReportedKind, ...] = get_args(ReportedKind)

MOST_ROWS = 200


@dataclass(frozen=True)
class ReportedRow:
    """A published result or a ceiling with its source, as ratios; null if not published.

    `note` is a remark for readers; `percent_digits` are the decimals of its printed percentages.
    """

    method: str
    modality: str
    source: str
    iou_occ: float | None = None
    iou_t: float | None = None
    iou_p: float | None = None
    iou_n: float | None = None
    miou: float | None = None
    note: str = ""
    percent_digits: int = PERCENT_DIGITS
    kind: ReportedKind = "published"


def is_reported_on(track: str | BindParameter[str]) -> ColumnElement[bool]:
    """Return the condition that a reported row is on the board of this track."""
    return or_(Reported.modality == track, Reported.kind == "ceiling")


def reported_in(session: Session, phase_id: str) -> list[Reported]:
    """Return the reported rows of a phase, by method and modality."""
    of_phase = select(Reported).where(Reported.phase_id == phase_id)
    return list(session.scalars(of_phase.order_by(Reported.method, Reported.modality)))


def put_reported(session: Session, phase: Phase, rows: Sequence[ReportedRow]) -> list[Reported]:
    """Replace the reported rows of the phase. Raises `reported_twice`."""
    lock_phase(session, phase.id)
    wanted = _by_key(rows)
    for standing in reported_in(session, phase.id):
        row = wanted.pop((standing.method, standing.modality), None)
        if row is None:
            session.delete(standing)
        else:
            _write(standing, row)
    for row in wanted.values():
        session.add(_write(Reported(phase_id=phase.id), row))
    session.flush()
    return reported_in(session, phase.id)


def _by_key(rows: Iterable[ReportedRow]) -> dict[tuple[str, str], ReportedRow]:
    keyed: dict[tuple[str, str], ReportedRow] = {}
    for row in rows:
        if (row.method, row.modality) in keyed:
            raise Refused(
                "reported_twice",
                f"{row.method[:80]!r} is listed twice with modality {row.modality}; give each method once",
            )
        keyed[row.method, row.modality] = row
    return keyed


def _write(standing: Reported, row: ReportedRow) -> Reported:
    for name in (field.name for field in fields(row)):
        setattr(standing, name, getattr(row, name))
    return standing
