"""A sequence is had processed from its page, as its owner chooses."""

from pathlib import Path
from typing import Any

import httpx
from playwright.sync_api import expect
from sqlalchemy import select

from services.domain.sequences.label_choices import BOUNDS
from services.runtime.orm import CalibrationRow, Job, Recording, SequenceRow
from services.runtime.platform import Platform
from stone_recordings.topics.roles import POSE_ROLES, POSITIONS
from testing.api.serving import Person
from testing.web.browsing import Site
from testing.worlds.made import sequence
from tests.web.looking import look
from web.sequence.topic_choices import ODOMETRY_ROLES, POSITION_TYPES, TopicChoices, choices_in

CALIBRATION = Path(__file__).parents[2] / "examples" / "kitti0005.calibration.yaml"

TOPICS = (
    ("/novatel/oem7/inspvax", "novatel_oem7_msgs/msg/INSPVAX", "ins", 500),
    ("/novatel/oem7/odom", "nav_msgs/msg/Odometry", "odometry", 500),
    ("/points", "sensor_msgs/msg/PointCloud2", "lidar", 100),
    ("/imu", "sensor_msgs/msg/Imu", "imu", 1000),
    ("/a name\u200b/no request may say", "nav_msgs/msg/Odometry", "odometry", 1),
)
INSPECTION: dict[str, Any] = {
    "topics": [dict(zip(("name", "type", "role", "count"), one, strict=True)) for one in TOPICS],
    "channels": {"lidar": "/points", "pose": "/novatel/oem7/inspvax"},
}


def recorded(platform: Platform, sequence_id: str) -> None:
    """The sequence has a recording that was read, and pins the one calibration."""
    with platform.database.transaction() as session:
        row = Recording(sequence_id=sequence_id, filename="run.mcap", size_bytes=3, sha256="0" * 64)
        row.state, row.inspection = "registered", INSPECTION
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
        form.get_by_label("Odometry topic").select_option("/novatel/oem7/odom")
        expect(form.get_by_label("Odometry topic").locator("option")).to_have_text(
            [
                "automatic (/novatel/oem7/inspvax)",
                "/novatel/oem7/inspvax · INSPVAX, 500 messages",
                "/novatel/oem7/odom · Odometry, 500 messages",
                "kiss-icp · computed from the sweeps",
            ]
        )
        expect(form.get_by_label("LiDAR topic").locator("option")).to_have_text(
            ["automatic (/points)", "/points · PointCloud2, 100 messages"]
        )
        look(page, "processing-form")
        form.get_by_role("button", name="Start processing").click()
        expect(form.get_by_text("Available when the current run has ended")).to_be_visible()
        expect(form.get_by_role("button", name="Start processing")).to_be_disabled()
    with site.platform.database.reading() as session:
        run = session.scalars(select(Job).where(Job.sequence_id == made["id"], Job.id == Job.root_id)).one()
    chosen = {key: run.arguments[key] for key in ("profile", "parameters", "odometry_topic", "stages")}
    assert chosen == {
        "profile": "local",
        "parameters": {"reference.alpha": 0.1},
        "odometry_topic": "/novatel/oem7/odom",
        "stages": ["synchronise", "label"],
    }


def test_before_a_recording_is_read_there_is_no_topic_to_choose(site: Site, curator: Person) -> None:
    with httpx.Client(base_url=site.url) as api:
        made = sequence(api, curator, "forest")
    with site.visit(curator) as page:
        page.goto(f"/sequences/{made['id']}/processing")
        page.get_by_text("Topics and parameters").click()
        for label in ("Odometry topic", "LiDAR topic"):
            expect(page.get_by_label(label)).to_be_disabled()


def test_the_topics_of_several_recordings_are_offered_once() -> None:
    again = {"topics": [INSPECTION["topics"][2]], "channels": {"lidar": "/points"}}
    found = choices_in([INSPECTION, again, None])
    assert (found.is_read, found.automatic_lidar) == (True, "/points")
    assert [(one.name, one.messages) for one in found.lidar] == [("/points", 200)]
    assert choices_in([INSPECTION, {"channels": {"lidar": "/other"}}]).automatic_lidar == ""
    assert choices_in([]) == TopicChoices()


def test_what_may_be_the_odometry_is_what_processing_takes() -> None:
    assert (ODOMETRY_ROLES, POSITION_TYPES) == (POSE_ROLES, (POSITIONS,))
