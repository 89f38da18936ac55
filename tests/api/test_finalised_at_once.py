"""A team that may have one more scored finalises twenty at the same moment, at a real API process: one passes.

Catches alone a quota that is passed by requests that really run side by side.
"""

from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier

import httpx
import pytest
from sqlalchemy import func, select

from services.runtime.orm import Job, SubmissionRow, Upload
from services.runtime.platform import Platform
from services.runtime.settings import BrokerSettings
from testing.api.process import running_api
from tests.services.domain.benchmarks.drafts import Entrant, drafted, entrant_on, finalised, taken, uploaded

pytestmark = pytest.mark.whole

AT_ONCE = 20
LIMIT = 5
NO_BROKER = BrokerSettings("redis://127.0.0.1:1/0")


def test_of_twenty_finalised_at_once_with_one_scoring_left_exactly_one_passes(
    platform_on: Platform, tmp_path: Path
) -> None:
    entrant = entrant_on(platform_on, scorings_per_window=LIMIT)
    before = [finalised(entrant) for _ in range(LIMIT - 1)]
    drafts = [drafted(entrant) for _ in range(AT_ONCE)]
    uploads = [uploaded(entrant, one) for one in drafts]
    with running_api(platform_on.settings.model_copy(update={"broker": NO_BROKER}), tmp_path / "api.log") as api:
        answers = _at_once(api.url, entrant, list(zip(drafts, uploads, strict=True)))
    assert Counter((one.status_code, one.json().get("code")) for one in answers) == {
        (202, None): 1,
        (429, "scorings_exhausted"): AT_ONCE - 1,
    }
    assert all(int(one.headers["Retry-After"]) > 0 for one in answers if one.status_code == 429)
    passed = next(one.json()["id"] for one in answers if one.status_code == 202)
    assert taken(entrant) == LIMIT
    _assert_settled(entrant, {*before, passed}, uploads)


def _at_once(url: str, entrant: Entrant, asked: list[tuple[str, str]]) -> list[httpx.Response]:
    """All of them, on connections of their own, none before all are ready."""
    ready = Barrier(len(asked))

    def finalize(one: tuple[str, str]) -> httpx.Response:
        with httpx.Client(base_url=url, headers=entrant.captain.headers, timeout=300.0, trust_env=False) as client:
            client.get("/api/v1/me").raise_for_status()
            ready.wait(300.0)
            return client.post(f"/api/v1/submissions/{one[0]}/finalize", json={"upload_id": one[1]})

    with ThreadPoolExecutor(len(asked)) as pool:
        return list(pool.map(finalize, asked))


def _assert_settled(entrant: Entrant, queued: set[str], uploads: list[str]) -> None:
    """These and no others are queued, each with a run; whoever was refused keeps draft and file."""
    with entrant.platform.database.reading() as session:
        of_team = select(SubmissionRow).where(SubmissionRow.team_id == entrant.team_id)
        rows = session.scalars(of_team).all()
        assert {row.id for row in rows if row.state == "queued"} == queued
        assert Counter(row.state for row in rows) == {"queued": LIMIT, "draft": AT_ONCE - 1}
        runs = select(func.count()).select_from(Job).where(Job.queue == "", Job.kind == "score")
        assert session.scalar(runs) == LIMIT
        states = Counter(session.scalars(select(Upload.state).where(Upload.id.in_(uploads))))
        assert states == {"consumed": 1, "complete": AT_ONCE - 1}
