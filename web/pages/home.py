"""The first page: the newest labelled sequence in 3D, the board of the newest benchmark, the first steps."""

from dataclasses import dataclass

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse
from sqlalchemy import select
from sqlalchemy.orm import Session

from api.deps import Caller, Looker, PlatformDep
from api.schemas.sequences.sequences import SequenceItem
from api.views.results import viewer_for
from api.views.sequences import sequence_items
from api.visible import benchmarks_of, sequences_shown_to
from services.domain.benchmarks.visibility import Viewer
from services.runtime.orm import Activation, Benchmark, LabelSet, Phase, SequenceRow
from web.boards.rows import ShownBoard, shown_board
from web.first_steps import FirstStep, steps_for
from web.rendering import page

router = APIRouter()


@dataclass(frozen=True)
class HomeContent:
    """The content of the first page; None for parts without visible data.

    `steps` are the caller's first steps, empty once all are done.
    """

    sequence: SequenceItem | None
    phase_id: str | None
    viewer: Viewer
    steps: tuple[FirstStep, ...]


@router.get("/")
def home(request: Request, caller: Looker, platform: PlatformDep) -> HTMLResponse:
    with platform.database.reading() as session:
        steps = steps_for(session, caller)
        featured = HomeContent(
            _newest_labelled(session, caller),
            _newest_board(session, caller),
            viewer_for(session, caller),
            () if all(step.is_done for step in steps) else steps,
        )
    board: ShownBoard | None = None
    if featured.phase_id is not None:
        board = shown_board(platform, featured.phase_id, featured.viewer)
    return page(request, caller, "home.html", sequence=featured.sequence, board=board, steps=featured.steps)


def _newest_labelled(session: Session, caller: Caller) -> SequenceItem | None:
    """Return the sequence that was labelled last."""
    labelled = sequences_shown_to(caller).join(LabelSet, LabelSet.sequence_id == SequenceRow.id)
    row = session.scalars(labelled.order_by(LabelSet.chosen_ns.desc(), LabelSet.id.desc()).limit(1)).first()
    return sequence_items(session, [row])[0] if row else None


def _newest_board(session: Session, caller: Caller) -> str | None:
    """Return the id of the phase whose ground truth was activated last."""
    shown = benchmarks_of(caller).with_only_columns(Benchmark.id)
    phases = select(Phase.id).join(Activation, Activation.phase_id == Phase.id).where(Phase.benchmark_id.in_(shown))
    return session.scalar(phases.order_by(Activation.activated_ns.desc(), Activation.id.desc()).limit(1))
