"""A sequence's page as its owner uses it: along the drive, live during a run, changed, processed again."""

import re
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.sync_api import Page, Route, expect
from sqlalchemy import select

from services.domain.sequences.label_choices import BOUNDS, DEFAULT_PROFILE, PROFILES
from services.domain.sequences.processing import PROCESS
from services.runtime.orm import CalibrationRow, Job, LabelSet, Recording, SequenceRow
from services.runtime.platform import Platform
from stone.labels.class_colours import CLASS_RGB, PALETTES, hex_of
from stone_recordings.topics.roles import POSE_ROLES, POSITIONS
from testing.api.serving import Person
from testing.web.browsing import Site
from testing.web.reading import Reading
from testing.worlds import made
from testing.worlds.benchmark_world import run_eval
from tests.web.looking import look
from tests.web.sequence_world import ASKED, CAMERAS, FRAMES, playback, whole_sequence
from tests.web.test_pages import STAGES, fail_at_the_surface, new_sequence
from web.sequence.topic_choices import ODOMETRY_ROLES, POSITION_TYPES, TopicChoices, choices_in

CALIBRATION = Path(__file__).parents[2] / "examples" / "kitti0005.calibration.yaml"
BEV = "img[data-bev]"


@pytest.fixture
def shown(platform: Platform, curator: Person) -> dict[str, Any]:
    return whole_sequence(platform, curator)


def to(page: Page, shown: dict[str, Any], section: str = "") -> None:
    answer = page.goto(f"/sequences/{shown['id']}{section}")
    assert answer is not None
    assert answer.status == 200


def token_of(page: Page, name: str) -> str:
    found: str = page.evaluate("name => getComputedStyle(document.documentElement).getPropertyValue(name)", name)
    return found.strip()


def test_somebody_moves_along_frames_and_track_by_keys_in_the_colours_they_chose(
    site: Site, platform: Platform, curator: Person, shown: dict[str, Any]
) -> None:
    playback(platform, shown)
    tokens = shown["tokens"]
    with site.visit(curator) as page:
        to(page, shown, f"/frames?frame={tokens[3]}")
        slider = page.get_by_role("slider", name="Frame")
        expect(slider).to_have_value("3")
        slider.press("ArrowRight")
        for channel in CAMERAS:
            expect(page.locator(f"[data-camera={channel}]")).to_have_attribute(
                "src", f"/api/v1/frames/{tokens[4]}/camera/{channel}.jpg?v={shown['label_set_id']}"
            )
        expect(page.locator(BEV)).to_have_js_property("naturalWidth", 512)
        slider.press("End")
        expect(page).to_have_url(f"{site.url}/sequences/{shown['id']}/frames?frame={tokens[-1]}")
        expect(page.get_by_role("link", name="This frame in 3D")).to_have_attribute(
            "href", f"/sequences/{shown['id']}/view?frame={tokens[-1]}"
        )
        slider.press("PageDown")
        expect(slider).to_have_value(str(FRAMES - 11))
        choose_the_papers_colours(page)
        page.get_by_role("slider", name="Frame").press("Space")
        expect(slider).to_have_value(str(FRAMES - 1))
        expect(page.get_by_role("button", name="Play")).to_be_visible()
        to(page, shown, "/track")
        slider = page.get_by_role("slider", name="Position along the track")
        slider.focus()
        slider.press("ArrowRight")
        expect(page.locator("[data-said]")).to_contain_text("0.1 s")
        expect(page.locator("[data-robot]")).to_have_attribute("visibility", "visible")
        expect(page.get_by_role("link", name="Open frame")).to_have_attribute(
            "href", f"/sequences/{shown['id']}/frames?frame={shown['tokens'][1]}"
        )


def choose_the_papers_colours(page: Page) -> None:
    """They are kept by page and pictures, also where the page is loaded again."""
    assert token_of(page, "--t") == hex_of(CLASS_RGB[1])
    page.get_by_label("Class colours").select_option("paper")
    expect(page.locator(BEV)).to_have_attribute("src", re.compile(r"[?&]colours=paper"))
    assert token_of(page, "--t") == hex_of(PALETTES["paper"][1])
    page.get_by_label("Next frame").click()
    expect(page.locator(BEV)).to_have_attribute("src", re.compile(r"[?&]colours=paper"))
    page.reload()
    expect(page.get_by_label("Class colours")).to_have_value("paper")
    assert token_of(page, "--n") == hex_of(PALETTES["paper"][3])
    page.get_by_label("Class colours").select_option("default")
    expect(page.locator("html")).not_to_have_attribute("data-colours", re.compile(".*"))


def test_the_owner_has_pictures_and_an_export_made_edits_shares_and_deletes_it(
    site: Site, curator: Person, shown: dict[str, Any]
) -> None:
    with site.visit(curator) as page:
        to(page, shown, "/frames")
        with page.expect_navigation():
            page.get_by_role("button", name="Extract images").click()
        expect(page.get_by_role("button", name="Extract images")).to_have_count(0)
        to(page, shown, "/exports")
        with page.expect_navigation():
            page.get_by_role("button", name="Create Mesh").click()
        expect(page.locator(".export-list")).to_contain_text("queued")
        to(page, shown)
        page.get_by_role("button", name="Edit").click()
        page.get_by_label("Environment").fill("rice-paddy")
        page.get_by_role("button", name="Save").click()
        expect(page.locator(".sequence-head")).to_contain_text("rice-paddy")
        page.get_by_role("button", name="Make public").click()
        page.get_by_role("dialog", name="Make it public").get_by_role("button", name="Make public").click()
        expect(page.get_by_role("button", name="Make private")).to_be_visible()
        with site.visit() as visitor:
            to(visitor, shown, "/frames")
        page.get_by_role("button", name="Delete").click()
        page.get_by_role("dialog").get_by_role("button", name="Delete").click()
        expect(page).to_have_url(f"{site.url}/sequences")


def advance(platform: Platform, run_id: str, kind: str, state: str) -> None:
    """As a worker would write it down."""
    with platform.database.transaction() as session:
        for row in session.scalars(select(Job).where(Job.root_id == run_id, Job.kind.in_([kind, "sequence.process"]))):
            row.state = state if row.kind == kind else "running"
            row.revision += 1


def test_a_run_is_followed_without_loading_the_page_again_also_after_a_busy_answer(site: Site, curator: Person) -> None:
    """A browser gives a stream up for good when the answer to it is none; the page would stand still without a word."""
    shown = new_sequence(site.platform, curator)
    run_id = made.run(site.platform, curator, "ingest.synchronise", "labeler.parts", sequence_id=shown["id"])
    refused: list[str] = []

    def refuse_once(route: Route) -> None:
        refused.append(route.request.url)
        if len(refused) == 1:
            route.fulfill(status=503, content_type="application/problem+json", body="{}")
        else:
            route.continue_()

    with site.visit(curator, expected=["503"]) as page:
        page.route("**/events", refuse_once)
        to(page, shown, "/processing")
        synchronising = page.locator(".run-steps li", has_text="Synchronise sensors")
        expect(synchronising).to_have_attribute("data-state", "waiting")
        page.evaluate("window.isSame = true")
        for state in ("running", "succeeded"):
            advance(site.platform, run_id, "ingest.synchronise", state)
            expect(synchronising).to_have_attribute("data-state", state)
        assert page.evaluate("window.isSame")
        page.get_by_role("button", name="Cancel this run").click()
        page.get_by_label("Reason").fill("the wrong calibration")
        page.get_by_role("dialog").get_by_role("button", name="Cancel this run").click()
        expect(page.locator("#runs .state").first).to_have_attribute("data-state", "cancelled")
        follow_the_next_run(page, site, curator, shown)
    assert len(refused) >= 2


def follow_the_next_run(page: Page, site: Site, curator: Person, shown: dict[str, Any]) -> None:
    """It starts while the page is open, and is followed until its labels count."""
    expect(page.get_by_role("button", name="Cancel this run")).to_have_count(0)
    now = made.run(site.platform, curator, "ingest.synchronise", sequence_id=shown["id"])
    expect(page.locator("#run-log")).to_have_attribute("data-log", f"/api/v1/jobs/{now}/logs")
    expect(page.get_by_role("button", name="Cancel this run")).to_be_visible()
    to(page, shown)
    expect(page.locator(".run-dashes")).to_be_visible()
    made.labels(site.platform, shown, contents=[made.frame_labels()] * 3)
    advance(site.platform, now, "ingest.synchronise", "succeeded")
    expect(page.get_by_role("heading", name="Summary")).to_be_visible()


def test_a_run_that_fails_is_said_without_loading_the_page_again_and_its_log_is_read(
    site: Site, curator: Person, shown: dict[str, Any]
) -> None:
    run_id = made.run(site.platform, curator, *STAGES, sequence_id=shown["id"])
    with site.visit(curator) as page:
        to(page, shown, "/track")
        expect(page.locator("#word")).to_have_text("queued")
        page.evaluate("window.isSame = true")
        fail_at_the_surface(site.platform, run_id)
        expect(page.locator("#word")).to_contain_text("re-run failed")
        expect(page.locator("#standing")).to_contain_text("surface_empty")
        assert page.evaluate("window.isSame"), "the page was loaded again"
        to(page, shown, "/processing")
        expect(page.get_by_role("log", name="Lines of the log")).to_contain_text("the tile has no surface")


def test_an_owner_reads_why_an_administrator_cancelled(
    reading: Reading, platform: Platform, curator: Person, administrator: Person
) -> None:
    shown = new_sequence(platform, curator)
    run_id = made.run(platform, curator, *STAGES, sequence_id=shown["id"])
    body, headers = {"reason": "disk maintenance at noon"}, administrator.headers
    assert reading.client.post(f"/api/v1/admin/jobs/{run_id}/cancel", json=body, headers=headers).is_success
    for part in ("", "/processing"):
        assert "disk maintenance at noon" in reading.html(f"/sequences/{shown['id']}{part}", curator), part


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


def calibrated(site: Site, owner: Person, sequence_id: str) -> None:
    """The sequence pins the one calibration of its owner."""
    with httpx.Client(base_url=site.url, headers=owner.headers) as api:
        api.post("/api/v1/calibrations", files={"file": ("rig.yaml", CALIBRATION.read_bytes())})
    with site.platform.database.transaction() as session:
        session.get_one(SequenceRow, sequence_id).calibration_id = session.scalars(select(CalibrationRow.id)).one()


def newest_run(platform: Platform, sequence_id: str) -> Job:
    with platform.database.reading() as session:
        runs = select(Job).where(Job.sequence_id == sequence_id, Job.kind == PROCESS).order_by(Job.id.desc())
        return session.scalars(runs).first() or pytest.fail("no run")


def test_an_owner_chooses_profile_parameters_and_topics(site: Site, curator: Person) -> None:
    made_id = new_sequence(site.platform, curator)["id"]
    calibrated(site, curator, made_id)
    with site.platform.database.transaction() as session:
        row = Recording(sequence_id=made_id, filename="run.mcap", size_bytes=3, sha256="0" * 64)
        row.state, row.inspection = "registered", INSPECTION
        session.add(row)
    with site.visit(curator) as page:
        page.goto(f"/sequences/{made_id}")
        form = page.locator("form[data-process]")
        form.get_by_text("Topics and parameters").click()
        fields = form.locator("[data-parameter]")
        bounds = fields.evaluate_all("all => all.map(one => [one.dataset.parameter, [+one.min, +one.max]])")
        assert {name: tuple(of) for name, of in bounds} == dict(BOUNDS)
        profiles = form.get_by_role("radio")
        names = profiles.evaluate_all("all => all.map(one => [one.value, one.checked])")
        assert names == [[name, name == DEFAULT_PROFILE] for name in PROFILES]
        form.get_by_role("radio", name="local").check()
        form.get_by_label("Significance").fill("0.7")
        form.get_by_role("button", name="Start processing").click()
        assert form.get_by_label("Significance").evaluate("field => field.validity.rangeOverflow")
        form.get_by_label("Significance").fill("0.1")
        form.get_by_label("Odometry topic").select_option("/novatel/oem7/odom")
        offered = [
            form.get_by_label(label).locator("option").evaluate_all("all => all.map(one => one.value)")
            for label in ("Odometry topic", "LiDAR topic")
        ]
        assert offered == [["", "/novatel/oem7/inspvax", "/novatel/oem7/odom", "kiss-icp"], ["", "/points"]]
        form.get_by_role("button", name="Start processing").click()
        expect(form.get_by_role("button", name="Start processing")).to_be_disabled()
        expect(page.locator("#run-log, .run-dashes").first).to_be_visible()
    run = newest_run(site.platform, made_id)
    assert {key: run.arguments[key] for key in ("profile", "parameters", "odometry_topic", "stages")} == {
        "profile": "local",
        "parameters": {"reference.alpha": 0.1},
        "odometry_topic": "/novatel/oem7/odom",
        "stages": ["synchronise", "label"],
    }


@pytest.mark.parametrize(("height_m", "is_off"), [(-2.157, True), (-1.80, False)])
def test_a_calibration_whose_ground_is_off_is_offered_its_correction_before_anything_is_processed(
    site: Site, curator: Person, height_m: float, is_off: bool
) -> None:
    """KITTI's LiDAR is 1.757 m above the ego origin by its calibration; the recording shows it 2.157 m above ground."""
    made_id = new_sequence(site.platform, curator)["id"]
    calibrated(site, curator, made_id)
    ground = {
        "sweeps": 40,
        "height_m": height_m,
        "slope_x": 0.0,
        "slope_y": 0.0,
        "map_slope_x": None,
        "map_slope_y": None,
    }
    ground |= {"low_m": height_m - 0.02, "high_m": height_m + 0.02}
    with site.platform.database.transaction() as session:
        row = Recording(sequence_id=made_id, filename="run.mcap", size_bytes=3, sha256="0" * 64)
        row.state, row.inspection = "registered", {**INSPECTION, "lidar_ground": ground}
        session.add(row)
    with site.visit(curator, expected=["409"] if is_off else []) as page:
        page.goto(f"/sequences/{made_id}")
        form = page.locator("form[data-process]")
        offer = form.get_by_label("Correct the height of the LiDAR for this run")
        expect(offer).to_have_count(1 if is_off else 0)
        if is_off:
            expect(form).to_contain_text("0.40 m below the ego origin")
            expect(form).to_contain_text("Corrected, the LiDAR is 2.16 m above the ground")
            expect(offer).to_be_checked()
            look(page, "ground-offer")
            offer.uncheck()
            form.get_by_role("button", name="Start processing").click()
            expect(page.get_by_text("ground auto corrects it for this run")).to_be_visible()
            offer.check()
        form.get_by_role("button", name="Start processing").click()
        expect(form.get_by_role("button", name="Start processing")).to_be_disabled()
        expect(page.locator("#run-log, .run-dashes").first).to_be_visible()
    assert newest_run(site.platform, made_id).arguments["ground"] == ("auto" if is_off else "given")


def test_an_owner_processes_again_with_profile_field_and_keeps_what_the_run_was_asked_for(
    site: Site, curator: Person, shown: dict[str, Any]
) -> None:
    calibrated(site, curator, shown["id"])
    with site.platform.database.transaction() as session:
        row = Recording(sequence_id=shown["id"], filename="cameras.mcap", size_bytes=3, sha256="0" * 64)
        row.state = "registered"
        session.add(row)
        session.flush()
        both = sorted(session.scalars(select(Recording.id).where(Recording.sequence_id == shown["id"])))
        run = session.get_one(Job, session.get_one(LabelSet, shown["label_set_id"]).job_id)
        run.arguments = {**run.arguments, **ASKED, "recording_ids": both}
        run_id = run.id
    with site.visit(curator) as page:
        to(page, shown)
        page.get_by_role("link", name="Change its settings").click()
        form = page.locator("form[data-process]")
        expect(form.get_by_role("radio", name="field")).to_be_checked()
        expect(form.get_by_label("Odometry topic")).to_have_value("kiss-icp")
        cleaning = form.get_by_label("Reference cleaning")
        expect(cleaning).to_have_attribute("placeholder", "3.5")
        expect(form).to_contain_text("current labels: 0.1")
        look(page, "processing-with-values")
        form.get_by_role("radio", name="paper").check()
        expect(cleaning).to_have_attribute("placeholder", "0")
        page.go_back()
        page.get_by_role("button", name="Process again with profile field").click()
        expect(page.locator(".run-dashes")).to_be_visible()
    run = newest_run(site.platform, shown["id"])
    assert run.id != run_id
    assert {key: run.arguments[key] for key in ASKED} == {**ASKED, "profile": "field"}
    assert sorted(run.arguments["recording_ids"]) == both


def test_the_owner_compares_two_label_sets(
    site: Site, reading: Reading, platform: Platform, curator: Person, shown: dict[str, Any]
) -> None:
    for seed, kind in ((b"one", 3), (b"other", 2)):
        made.labels(platform, shown, contents=[made.frame_labels(kind)] * 2, seed=seed)
    with site.visit(curator) as page:
        to(page, shown, "/label-sets")
        newest = page.get_by_role("region", name="Label sets").get_by_role("row").nth(1)
        expect(newest).to_contain_text("97.3 % of 75 m")
        expect(newest.get_by_role("link", name="LAB-605")).to_have_attribute("href", "/codes/LAB-605")
        oldest = page.get_by_role("region", name="Label sets").get_by_role("row").last
        expect(newest).to_contain_text("active")
        expect(oldest).not_to_contain_text("open in 3D")
        over = oldest.get_by_role("link", name="open over the active one in 3D")
        expect(over).to_have_attribute("href", re.compile(r"/view\?second=[0-9a-f]{32}$"))
        look(page, "sequence-label-sets")
        with page.expect_navigation():
            oldest.get_by_role("button", name="Make active").click()
        expect(oldest.get_by_role("link", name="open in 3D")).to_be_visible()
        expect(newest).not_to_contain_text("open in 3D")
        page.get_by_role("button", name="Compare").click()
        expect(page.get_by_role("region", name="A and B compared")).to_contain_text("queued")
    run_eval(platform)
    html = reading.html(f"/sequences/{shown['id']}/label-sets", curator)
    assert 'aria-label="Confusion' in html
    (picture, *_) = re.findall(r'<img[^>]* src="(/api/v1/[^"]+)"', html.partition("A and B compared")[2])
    answer = reading.client.get(picture.replace("&amp;", "&"), headers=curator.headers)
    assert (answer.status_code, answer.headers["content-type"]) == (200, "image/png")


def test_the_owner_deletes_a_label_set_by_keyboard_and_one_that_is_exported_says_why_not(
    site: Site, platform: Platform, curator: Person, shown: dict[str, Any]
) -> None:
    older, newer = (
        made.labels(platform, shown, contents=[made.frame_labels()] * 2, seed=seed) for seed in (b"1", b"2")
    )
    made.export(platform, shown["id"], {"mesh.ply": b"ply"})
    with site.visit(curator, expected=["409"]) as page:
        to(page, shown, "/label-sets")
        rows = page.get_by_role("region", name="Label sets").get_by_role("row")
        before = rows.count()
        rows.nth(2).get_by_role("button", name="Delete").focus()
        page.keyboard.press("Enter")
        dialog = page.get_by_role("dialog", name="Delete this label set?")
        expect(dialog).to_be_visible()
        look(page, "sequence-label-set-deletion")
        page.keyboard.press("Escape")
        expect(dialog).to_be_hidden()
        rows.nth(1).get_by_role("button", name="Delete").click()
        dialog.get_by_role("button", name="Delete").click()
        expect(dialog.get_by_role("alert")).to_contain_text("its export")
        dialog.get_by_role("button", name="Cancel").click()
        rows.nth(2).get_by_role("button", name="Delete").click()
        dialog.get_by_role("button", name="Delete").press("Enter")
        expect(rows).to_have_count(before - 1)
        look(page, "sequence-label-sets-left")
    with platform.database.reading() as session:
        assert session.get(LabelSet, newer.id) is not None
        assert session.get(LabelSet, older.id) is None


def test_the_topics_of_several_recordings_are_offered_once() -> None:
    again = {"topics": [INSPECTION["topics"][2]], "channels": {"lidar": "/points"}}
    found = choices_in([INSPECTION, again, None])
    assert (found.is_read, found.automatic_lidar) == (True, "/points")
    assert [(one.name, one.messages) for one in found.lidar] == [("/points", 200)]
    assert choices_in([INSPECTION, {"channels": {"lidar": "/other"}}]).automatic_lidar == ""
    assert choices_in([]) == TopicChoices()
    assert (ODOMETRY_ROLES, POSITION_TYPES) == (POSE_ROLES, (POSITIONS,))


def test_a_finding_names_its_subject_and_has_the_width_of_its_card(
    site: Site, curator: Person, shown: dict[str, Any]
) -> None:
    """On the overview "its points have no readable time" had lost whose, and stood in a third of the card."""
    with site.visit(curator) as page:
        to(page, shown)
        findings = page.get_by_role("region", name="Findings").locator(".finding")
        expect(findings.first).to_contain_text("the track spans 3.11 m")
        page.get_by_role("region", name="Findings").locator("summary").first.click()
        expect(findings.filter(has_text="TIM-201")).to_contain_text("/ins: Stamped on the host.")
        ratio = findings.first.evaluate(
            "one => one.querySelector('span:not(.harm)').getBoundingClientRect().width / one.clientWidth"
        )
        assert ratio > 0.85
        look(page, "sequence-findings")


def test_a_visitor_of_a_public_sequence_sees_its_rig_with_extrinsics(
    site: Site, platform: Platform, curator: Person, shown: dict[str, Any]
) -> None:
    calibrated(site, curator, shown["id"])
    with platform.database.transaction() as session:
        session.get_one(SequenceRow, shown["id"]).is_public = True
    with site.visit() as page:
        to(page, shown, "/calibration")
        rig = page.get_by_role("region", name="Sensor rig")
        expect(rig.get_by_role("img", name="From above")).to_be_visible()
        rig.get_by_text("Positions and orientations").click()
        expect(rig.get_by_role("region", name="Sensor positions").get_by_role("row").nth(1)).to_contain_text("LIDAR")
        look(page, "sequence-rig")


def test_a_calibration_at_fault_is_marked_so_and_its_code_explained(
    reading: Reading, platform: Platform, curator: Person
) -> None:
    """The step had a green tick, and the code alone was no link."""
    shown = new_sequence(platform, curator)
    run_id = made.run(platform, curator, "ingest.synchronise", sequence_id=shown["id"])
    with platform.database.transaction() as session:
        for row in session.scalars(select(Job).where(Job.root_id == run_id)):
            row.state, row.failure_code, row.failure = "failed", "CAL-412", "the sizes of CAM_FRONT differ"
    html = reading.html(f"/sequences/{shown['id']}", curator)
    steps = re.findall(r'<li data-state="(\w+)"><a href="#(\w+)">', html)
    assert dict((at, state) for state, at in steps)["calibration"] == "failed"
    assert '<a class="code" href="/codes/CAL-412">' in html
