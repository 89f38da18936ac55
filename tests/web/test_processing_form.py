"""A sequence is had processed from its page, as its owner chooses."""

from pathlib import Path

import httpx
from playwright.sync_api import expect
from sqlalchemy import select

from services.domain.sequences.label_choices import BOUNDS
from services.runtime.orm import CalibrationRow, Job, Recording, SequenceRow
from services.runtime.platform import Platform
from testing.api.serving import Person
from testing.web.browsing import Site
from testing.worlds.made import sequence
from tests.web.looking import look

CALIBRATION = Path(__file__).parents[2] / "examples" / "kitti0005.calibration.yaml"


def recorded(platform: Platform, sequence_id: str) -> None:
    """The sequence has a recording that was read, and pins the one calibration."""
    with platform.database.transaction() as session:
        row = Recording(sequence_id=sequence_id, filename="run.mcap", size_bytes=3, sha256="0" * 64)
        row.state = "registered"
        session.add(row)
        session.get_one(SequenceRow, sequence_id).calibration_id = session.scalars(select(CalibrationRow.id)).one()


def test_an_owner_chooses_profile_and_parameters(site: Site, curator: Person) -> None:
    with httpx.Client(base_url=site.url, headers=curator.headers) as api:
        made = sequence(api, curator, "forest")
        api.post("/api/v1/calibrations", files={"file": ("rig.yaml", CALIBRATION.read_bytes())})
    recorded(site.platform, made["id"])
    with site.visit(curator) as page:
        page.goto(f"/sequences/{made['id']}")
        form = page.locator("form[data-process]")
        form.get_by_text("Topics and parameters").click()
        fields = form.locator("[data-parameter]")
        bounds = fields.evaluate_all("all => all.map(one => [one.dataset.parameter, [+one.min, +one.max]])")
        assert {name: tuple(of) for name, of in bounds} == dict(BOUNDS)
        form.get_by_role("radio", name="local").check()
        form.get_by_label("Significance").fill("0.7")
        form.get_by_role("button", name="Start processing").click()
        assert form.get_by_label("Significance").evaluate("field => field.validity.rangeOverflow")
        form.get_by_label("Significance").fill("0.1")
        form.get_by_label("Odometry topic").fill("kiss-icp")
        look(page, "processing-form")
        form.get_by_role("button", name="Start processing").click()
        expect(form.get_by_text("Once what runs now has ended")).to_be_visible()
        expect(form.get_by_role("button", name="Start processing")).to_be_disabled()
    with site.platform.database.reading() as session:
        run = session.scalars(select(Job).where(Job.sequence_id == made["id"], Job.id == Job.root_id)).one()
    chosen = {key: run.arguments[key] for key in ("profile", "parameters", "odometry_topic", "stages")}
    assert chosen == {
        "profile": "local",
        "parameters": {"reference.alpha": 0.1},
        "odometry_topic": "kiss-icp",
        "stages": ["synchronise", "label"],
    }
