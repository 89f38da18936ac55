"""What is to be seen of a submission by whom, and when: the expectations, cell by cell, and how each is looked for.

**Conventions.** The table stands here for itself; nothing of it is read from the code it judges. A viewer sees a field
if any way of looking finds it. `a` is an administrator, `m` a member of the team, `o` anybody else.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

from sqlalchemy.orm import Session

from services.domain.benchmarks.boards.board import LeaderboardRow, board
from services.domain.benchmarks.boards.comparison import compare
from services.domain.benchmarks.boards.entries import BoardQuery
from services.domain.benchmarks.submissions.predicted_frames import downloadable_zip, pictured_zip
from services.domain.benchmarks.submissions.results import (
    BY,
    ScoreView,
    SubmissionResults,
    breakdown,
    kept_confusions,
    provenance,
    results,
)
from services.domain.benchmarks.visibility import Viewer
from services.runtime.orm import SubmissionRow
from stone.errors import StoneError
from tests.services.domain.benchmarks.boards import Scene

EXPECTED = """
                 open   running  ended   unnamed
rounded totals   amo    amo      amo     amo
exact totals     amo    a        amo     amo
intervals        amo    a        amo     amo
ranks            amo    amo      amo     amo
comparison       amo    a        amo     amo
sequence         amo    a        amo     amo
environment      amo    a        amo     amo
illumination     amo    a        amo     amo
distance         amo    a        amo     amo
support          amo    a        amo     amo
confusion        amo    a        amo     amo
extras           amo    a        amo     amo
within occupied  amo    a        amo     amo
tolerant         amo    a        amo     amo
columns          amo    a        amo     amo
by frame         am     a        a       am
content          am     a        a       am
signature        amo    amo      amo     amo
code version     amo    amo      amo     amo
file             am     am       am      am
method           amo    amo      amo     amo
description      amo    amo      amo     am
team             amo    amo      amo     am
frames           amo    -        -       amo
predictions      am     am       am      am
baseline zip     amo    am       am      amo
"""
RELATIONS = ("a", "m", "o")
STANDINGS = tuple(EXPECTED.split("\n")[1].split())


def expected(standing: str, relation: str) -> set[str]:
    """The fields that this viewer sees while the phase stands so."""
    column = STANDINGS.index(standing)
    rows = [line.rsplit(maxsplit=len(STANDINGS)) for line in EXPECTED.splitlines()[2:]]
    return {field for field, *cells in rows if relation in cells[column]}


def seen_fields(at: Scene, ids: tuple[str, str], viewer: Viewer) -> set[str]:
    """The fields of the first of two submissions that the viewer finds anywhere."""
    with at.platform.database.reading() as session:
        rows = [session.get_one(SubmissionRow, one) for one in ids]
        found = results(session, viewer, rows[0])
        seen: set[str] = {by for by in BY if _is_told(partial(breakdown, found.seen, by))}
        seen |= {"by frame"} if _is_told(partial(kept_confusions, session, found.seen)) else set()
        seen |= _zips_told(session, found.seen)
        origin = provenance(found.seen)
    row = next(
        row
        for row in board(at.platform, at.phase_id, BoardQuery(entries="all"), viewer).rows
        if row.submission_id == ids[0]
    )
    said = comparison_says(at, (rows[0], rows[1]), viewer)
    exact = {name: getattr(found.seen.score, name) for name in found.total}
    looked: Mapping[str, object] = {
        **_of_totals([dict(found.total), dict(row.ratios)], exact),
        **_of_results(found, row),
        "comparison": said,
        "content": origin.content_sha256,
        "signature": origin.seen.score.signature,
        "code version": origin.code_version,
        "file": origin.prediction_sha256 or origin.size_bytes,
    }
    return seen | {name for name, value in looked.items() if value}


def comparison_says(at: Scene, both: tuple[SubmissionRow, SubmissionRow], viewer: Viewer) -> bool:
    """Whether the comparison tells more than the difference of the totals."""
    found = compare(at.platform, at.phase_id, both, viewer).ratios.values()
    return any(one.these_places or one.new_place or one.silences or one.sign_flip for one in found)


def _zips_told(session: Session, seen: ScoreView) -> set[str]:
    """Which uses of the zip are not refused; the scene keeps no zip, so what is allowed finds none."""
    baseline = replace(seen, submission=SubmissionRow(id=seen.submission.id, kind="baseline"))
    asked = {
        "frames": partial(pictured_zip, session, seen),
        "predictions": partial(downloadable_zip, session, seen),
        "baseline zip": partial(downloadable_zip, session, baseline),
    }
    return {name for name, look in asked.items() if _is_told(look)}


def _of_totals(told: list[dict[str, float | None]], exact: dict[str, float]) -> dict[str, bool]:
    rounded = {name: round(value, 4) for name, value in exact.items()}
    shown = [value for one in told for value in one.values()]
    return {
        "exact totals": any(value in exact.values() for value in shown),
        "rounded totals": all({name: round(value or 0, 4) for name, value in one.items()} == rounded for one in told),
    }


def _of_results(found: SubmissionResults, row: LeaderboardRow) -> dict[str, object]:
    return {
        "intervals": found.intervals or found.silences or row.intervals,
        "ranks": row.rank_interval or row.tie_group,
        "support": found.support or row.support,
        "confusion": found.confusion,
        "extras": found.extras or row.danger,
        "within occupied": found.within_occupied,
        "tolerant": found.tolerant,
        "columns": found.columns,
        "method": found.seen.submission.method,
        "description": found.description,
        "team": found.team or row.team,
    }


def _is_told(look: Callable[[], object]) -> bool:
    try:
        return bool(look())
    except StoneError as error:
        if error.code not in ("predictions_gone", "withheld", "frames_hidden"):
            raise
        return error.code == "predictions_gone"
