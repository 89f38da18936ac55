"""A phase as administrators run it, and its re-scores: `/admin/benchmarks/{b}/{p}` and below."""

from typing import Any

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse
from sqlalchemy import select

from api.deps import Administrator, PlatformDep
from api.etags import etag
from api.routes.admin.admin_rescores import board_revision, rescore_of
from api.schemas.admin import AlarmItem
from api.schemas.base import IdPath
from api.schemas.phase_bodies import BenchmarkName, PhaseName
from api.schemas.rescores import RescoreDiffAnswer
from api.views.audit import team_quotas
from api.views.benchmarks import phase_detail
from api.views.rescores import rescore_item
from api.views.truths import reported_item, truth_items
from api.visible import phase_at
from services.domain.benchmarks.alarms.alarms import open_alarms
from services.domain.benchmarks.modalities import MODALITIES
from services.domain.benchmarks.phases.reported_results import KINDS, reported_in
from services.domain.benchmarks.rescores.diff import rescore_diff
from services.runtime.orm import Alarm, GroundTruthRow, Job, Rescore
from stone.scoring.metric import METRICS
from web.boards.slopes import slope_picture
from web.pages.admin.benchmarks import versions
from web.rendering import page

router = APIRouter()
MOST_TEAMS, MOST_ALARMS = 500, 100
RATIOS = ("iou_occ", "iou_t", "iou_p", "iou_n", "miou")


@router.get("/admin/benchmarks/{benchmark_name}/{phase_name}")
def phase(
    benchmark_name: BenchmarkName,
    phase_name: PhaseName,
    request: Request,
    caller: Administrator,
    platform: PlatformDep,
) -> HTMLResponse:
    with platform.database.reading() as session:
        row = phase_at(session, caller, benchmark_name, phase_name)
        truths = select(GroundTruthRow).where(GroundTruthRow.phase_id == row.id).order_by(GroundTruthRow.id.desc())
        rescores = select(Rescore).where(Rescore.phase_id == row.id).order_by(Rescore.id.desc())
        alarms = open_alarms(row.id).order_by(Alarm.id.desc()).limit(MOST_ALARMS)
        values: dict[str, Any] = {
            "phase": phase_detail(session, row),
            "tag": etag(row.revision),
            "truths": truth_items(session, row, session.scalars(truths).all()),
            "rescores": [rescore_item(session, rescore) for rescore in session.scalars(rescores)],
            "alarms": [AlarmItem.of(alarm) for alarm in session.scalars(alarms)],
            "teams": team_quotas(session, row, MOST_TEAMS),
            "reported": [reported_item(reported) for reported in reported_in(session, row.id)],
            "datasets": versions(session),
        }
    detail = values["phase"]
    values["metrics"] = [metric for metric in METRICS.values() if metric.successor is None]
    values["superseded"] = detail.active and detail.active.metric in METRICS and METRICS[detail.active.metric].successor
    return page(request, caller, "admin/phase.html", modalities=MODALITIES, kinds=KINDS, ratios=RATIOS, **values)


@router.get("/admin/benchmarks/{benchmark_name}/{phase_name}/rescores/{rescore_id}")
def rescore(
    benchmark_name: BenchmarkName,
    phase_name: PhaseName,
    rescore_id: IdPath,
    request: Request,
    caller: Administrator,
    platform: PlatformDep,
) -> HTMLResponse:
    with platform.database.reading() as session:
        at = phase_at(session, caller, benchmark_name, phase_name)
        row = rescore_of(session, at.id, rescore_id)
        diff = RescoreDiffAnswer.of(rescore_diff(session, row), rescore=rescore_item(session, row))
        job = session.get(Job, row.job_id) if row.job_id else None
        values: dict[str, Any] = {
            "phase": phase_detail(session, at),
            "tag": etag(board_revision(session, at.id)),
            "job": job,
        }
    picture = slope_picture(diff.rows)
    return page(request, caller, "admin/rescore.html", diff=diff, rescore=diff.rescore, picture=picture, **values)
