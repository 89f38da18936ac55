"""Labels that profile local would mend are made again with it, and nothing else of the run changes."""

import json
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.sync_api import expect
from sqlalchemy import select

from services.domain.sequences.processing import PROCESS
from services.runtime.orm import CalibrationRow, Job, LabelSet, Recording, SequenceRow
from services.runtime.platform import Platform
from testing.api.serving import Person
from testing.web.browsing import Site
from tests.web.looking import look
from tests.web.sequence_world import REPORT, replace_files, whole_sequence

CALIBRATION = Path(__file__).parents[2] / "examples" / "kitti0005.calibration.yaml"
OFFER = "Process again with profile local"
ASKED: dict[str, Any] = {
    "profile": "paper",
    "parameters": {"reference.alpha": 0.1},
    "odometry_topic": "kiss-icp",
    "lidar_topic": "/lidar",
    "ground": "auto",
    "names_recordings": True,
    "clock_offsets_ns": {"cameras.mcap": -80_000_000},
    "stages": ["synchronise", "label"],
}


@pytest.fixture
def labelled(site: Site, curator: Person) -> dict[str, Any]:
    """A labelled sequence of two recordings, whose run was asked for `ASKED`; the ids of the recordings beside it."""
    facts = whole_sequence(site.platform, curator)
    with httpx.Client(base_url=site.url, headers=curator.headers) as api:
        api.post("/api/v1/calibrations", files={"file": ("rig.yaml", CALIBRATION.read_bytes())})
    with site.platform.database.transaction() as session:
        row = Recording(sequence_id=facts["id"], filename="cameras.mcap", size_bytes=3, sha256="0" * 64)
        row.state = "registered"
        session.add(row)
        session.get_one(SequenceRow, facts["id"]).calibration_id = session.scalars(select(CalibrationRow.id)).one()
        session.flush()
        both = sorted(session.scalars(select(Recording.id).where(Recording.sequence_id == facts["id"])))
        run = session.get_one(Job, session.get_one(LabelSet, facts["label_set_id"]).job_id)
        run.arguments = {**run.arguments, **ASKED, "recording_ids": both}
    return {**facts, "recording_ids": both, "run_id": run.id}


def newest_run(platform: Platform, sequence_id: str) -> Job:
    with platform.database.reading() as session:
        runs = select(Job).where(Job.sequence_id == sequence_id, Job.kind == PROCESS).order_by(Job.id.desc())
        return session.scalars(runs).first() or pytest.fail("no run")


def test_an_owner_processes_again_with_profile_local_and_keeps_what_the_run_was_asked_for(
    site: Site, curator: Person, labelled: dict[str, Any]
) -> None:
    with site.visit(curator) as page:
        page.goto(f"/sequences/{labelled['id']}")
        page.get_by_role("link", name=OFFER).click()
        form = page.locator("form[data-process]")
        expect(form.get_by_role("radio", name="local")).to_be_checked()
        expect(form.get_by_label("Odometry topic")).to_have_value("kiss-icp")
        expect(form.get_by_label("LiDAR topic")).to_have_value("/lidar")
        expect(form.get_by_label("Significance")).to_have_value("0.1")
        expect(form).to_contain_text("Kept as well: ground auto, 2 chosen recordings, cameras.mcap -0.080000 s.")
        look(page, "process-again")
        form.get_by_role("button", name="Start processing").click()
        expect(page).to_have_url(f"{site.url}/sequences/{labelled['id']}")
        expect(page.get_by_role("link", name=OFFER)).to_have_count(0)  # while it runs
    run = newest_run(site.platform, labelled["id"])
    assert run.id != labelled["run_id"]
    assert {key: run.arguments[key] for key in ASKED} == {**ASKED, "profile": "local"}
    assert sorted(run.arguments["recording_ids"]) == labelled["recording_ids"]


def test_the_form_is_blank_where_nobody_comes_from_a_finding(
    site: Site, curator: Person, labelled: dict[str, Any]
) -> None:
    with site.visit(curator) as page:
        page.goto(f"/sequences/{labelled['id']}/processing")
        form = page.locator("form[data-process]")
        expect(form.get_by_role("radio", name="paper")).to_be_checked()
        expect(form.get_by_label("Odometry topic")).to_have_value("")
        assert form.get_attribute("data-kept") is None


def test_it_is_offered_to_who_may_process_and_only_where_profile_local_helps(
    site: Site, curator: Person, participant: Person, labelled: dict[str, Any]
) -> None:
    sequence_id = labelled["id"]
    with site.platform.database.transaction() as session:
        session.get_one(SequenceRow, sequence_id).is_public = True
    for somebody in (None, participant):
        with site.visit(somebody) as page:
            page.goto(f"/sequences/{sequence_id}")
            expect(page.get_by_role("link", name="LAB-603")).to_be_visible()
            expect(page.get_by_role("link", name=OFFER)).to_have_count(0)
    reports = (
        {**REPORT, "parameters": {"profile": "local"}},
        {**REPORT, "findings": REPORT["findings"][:1]},
    )
    for report in reports:
        replace_report(site.platform, labelled, report)
        with site.visit(curator) as page:
            page.goto(f"/sequences/{sequence_id}")
            expect(page.get_by_role("heading", name="Findings")).to_be_visible()
            expect(page.get_by_role("link", name=OFFER)).to_have_count(0)


def replace_report(platform: Platform, labelled: dict[str, Any], report: dict[str, Any]) -> None:
    replace_files(platform, labelled["label_set_id"], {"report.json": json.dumps(report).encode()})
