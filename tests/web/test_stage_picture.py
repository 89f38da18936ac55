"""The Gantt chart of a run: stages in the order in which they began, each with a title."""

from api.views.admin import JobSpan
from services.eval import stages as scoring
from services.ingest import stages as ingest
from services.labeler import stages as labelling
from services.maintenance.notifications import delivery
from services.runtime.jobs.titles import TITLES
from services.runtime.notifications.run_events import TOLD_FAILED
from services.runtime.platform import Platform
from web.stage_picture import stage_picture

SECOND = 10**9


def span(kind: str, began_s: int | None, made: int) -> JobSpan:
    ended_ns = None if began_s is None else (began_s + 2) * SECOND
    state = "queued" if began_s is None else "succeeded"
    started_ns = None if began_s is None else began_s * SECOND
    return JobSpan(f"{made:032x}", kind, state, 1, 0, started_ns, ended_ns)


def test_rows_stand_in_the_order_in_which_their_stages_began_and_those_to_come_last() -> None:
    spans = [
        span("labeler.fuse", 3, 0),
        span("labeler.surface", 9, 1),
        span("labeler.sight", 5, 2),
        span("labeler.publish", None, 3),
        span("ingest.synchronise", 1, 4),
        span("labeler.surface", 4, 5),
    ]
    picture = stage_picture(spans, 20 * SECOND)
    assert picture is not None
    assert [row.kind for row in picture.rows] == [
        "ingest.synchronise",
        "labeler.fuse",
        "labeler.surface",
        "labeler.sight",
        "labeler.publish",
    ]
    assert picture.rows[1].title == "Fuse sweeps"


def test_every_kind_of_job_and_run_has_a_title(platform: Platform) -> None:
    kinds = {kind for module in (ingest, labelling, scoring, delivery) for kind in module.handlers(platform)}
    assert kinds | set(TOLD_FAILED) | {"score"} <= set(TITLES)
