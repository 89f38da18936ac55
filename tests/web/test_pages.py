"""What pages say, read as their bytes: to whom which page is shown, and the values that each is there to tell."""

import json
import re
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import select, update

from api.client_wheel import FILENAME, ClientWheel
from services.runtime.embedded.first_start import PASSWORD_FILE, ensure_keys
from services.runtime.orm import Benchmark, Job, JobAttempt, JobLine, SequenceRow, SubmissionRow
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.settings import ApiSettings, Settings
from simulator.pipeline import calibration_path
from stone.splits.splits import Split
from stone_base.codes.catalogue import CATALOGUE
from stone_base.codes.meaning import HARM_WORDS
from testing.api.serving import Person, client_of, person
from testing.servers.fixtures import Bells, opened
from testing.web.reading import Reading, reading_of
from testing.worlds import made, published
from testing.worlds.benchmark_world import SHAPE, benchmark_world, labelled
from testing.worlds.brought_datasets import bring_dataset
from testing.worlds.published_datasets import SyntheticDataset, made_labels, write_published_tar
from testing.worlds.runs import run_all
from tests.api.boarding import boarding
from tests.web.bringing import bag
from tests.web.dataset_world import campaign, driven, put
from tests.web.listed_world import listed_world
from tests.web.sequence_world import REPORT, replace_files, whole_sequence
from web.pages import docs

NO_ID = "0" * 32
ROLES = ("visitor", "participant", "curator", "administrator")
PAGES = f"""
/                     200 200 200 200
/sign-in              200 200 200 200
/downloads/           200 200 200 200
/codes                200 200 200 200
/codes/LAB-603        200 200 200 200
/codes/none           401 404 404 404
/docs/                200 200 200 200
/help                 200 200 200 200
/benchmarks           200 200 200 200
/benchmarks/none      401 404 404 404
/benchmarks/none/val  401 404 404 404
/benchmarks/none/val/compare             401 404 404 404
/benchmarks/none/val/metrics/stone-iou-2 401 404 404 404
/benchmarks/none/val/data                401 404 404 404
/benchmarks/none/val/rules               401 404 404 404
/benchmarks/none/val/submit              401 404 404 404
/entries/{NO_ID}      401 404 404 404
/sequences            200 200 200 200
/sequences/new        401 403 200 200
/imports              401 403 200 200
/imports/{NO_ID}      401 403 404 404
/calibrations         401 200 200 200
/calibrations/{NO_ID} 401 404 404 404
/account              401 200 200 200
/device               401 200 200 200
/device?code=BCDF-GHJK 401 200 200 200
/dataset              401 200 200 200
/dataset?version=none 401 404 404 404
/dataset/splits       401 403 200 200
/dataset/new          401 403 403 200
/submissions          401 200 200 200
/submissions/{NO_ID}  401 404 404 404
/teams                401 200 200 200
/teams/{NO_ID}        401 404 404 404
/admin/users          401 403 403 200
/admin/users/{NO_ID}  401 403 403 404
/admin/audit          401 403 403 200
/admin/jobs           401 403 403 200
/admin/jobs?list=dead 401 403 403 200
/admin/durations      401 403 403 200
/admin/jobs/{NO_ID}   401 403 403 404
/admin/queues         401 403 403 200
/admin/benchmarks     401 403 403 200
"""
OPEN = ("", "/frames", "/track", "/calibration", "/exports")
OWN = ("/recordings", "/processing", "/label-sets")


@pytest.mark.whole
def test_each_page_is_shown_to_those_it_is_for(platform: Platform, reading: Reading) -> None:
    shown: dict[str, Person | None] = {"visitor": None} | {role: person(platform, role) for role in ROLES[1:]}
    for path, *statuses in map(str.split, PAGES.strip().splitlines()):
        for role, status in zip(ROLES, map(int, statuses), strict=True):
            answer = reading.answer(path, shown[role])
            assert answer.status_code == status, f"{role} at {path}: {answer.text[:300]}"
            assert answer.headers["content-type"].startswith("text/html")
            assert "default-src 'none'" in answer.headers["content-security-policy"]
            assert role == "administrator" or 'href="/admin' not in answer.text, f"{role} at {path}"


def new_sequence(platform: Platform, owner: Person, name: str = "forest") -> dict[str, str]:
    with platform.database.transaction() as session:
        row = SequenceRow(owner_id=owner.user_id, name=name)
        session.add(row)
        session.flush()
        return {"id": row.id, "name": row.name, "owner_id": owner.user_id}


def publish(platform: Platform, sequence_id: str) -> None:
    with platform.database.transaction() as session:
        session.get_one(SequenceRow, sequence_id).is_public = True


@pytest.mark.whole
@pytest.mark.parametrize(("is_public", "seen"), [(False, 404), (True, 200)])
def test_others_see_what_is_public_of_a_sequence_and_never_what_is_only_its_owners(
    platform: Platform, reading: Reading, curator: Person, participant: Person, is_public: bool, seen: int
) -> None:
    shown = new_sequence(platform, curator)
    made.labels(platform, shown, contents=[made.frame_labels()] * 3)
    if is_public:
        publish(platform, shown["id"])

    def statuses(sections: tuple[str, ...], who: Person | None) -> set[int]:
        return {reading.status(f"/sequences/{shown['id']}{section}", who) for section in sections}

    assert statuses((*OPEN, "/view"), participant) == {seen}
    assert statuses((*OPEN, "/view"), None) == {200 if is_public else 401}
    assert statuses(OWN, participant) == {404}
    assert statuses(OWN, None) == {401}
    assert statuses((*OPEN, *OWN), curator) == {200}


@pytest.mark.whole
def test_what_is_of_somebody_else_has_no_page(reading: Reading, platform: Platform, curator: Person) -> None:
    world = benchmark_world(platform, frames=1)
    with client_of(platform, curator) as api:
        file = {"file": ("rig.yaml", calibration_path(bag()).read_bytes())}
        calibration = api.post("/api/v1/calibrations", files=file).json()
        file = {"file": ("rig.yaml", calibration_path(bag()).read_bytes() + b"vehicle: {max_slope_deg: 30}\n")}
        steeper = api.post("/api/v1/calibrations", files=file).json()
    with platform.database.transaction() as session:
        kept = {"phase_id": world.val, "team_id": world.teams[0], "user_id": world.captains[0].user_id}
        entry = SubmissionRow(**kept, method="Net", modality="L", declared_sha256="0" * 64, size_bytes=1)
        session.add(entry)
        session.flush()
        paths = (f"/submissions/{entry.id}", f"/teams/{world.teams[0]}")
    calibrations = (f"/calibrations/{calibration['id']}",)
    for path, whose in [(path, world.member) for path in paths] + [(path, curator) for path in calibrations]:
        statuses = [reading.status(path, who) for who in (whose, world.captains[1], None)]
        assert statuses == [200, 404, 401], path
    assert "slope 20°, step 0.12 m, height 1.6 m" in reading.html(*calibrations, curator)
    assert "max_slope_deg 20.0 → 30.0" in reading.html(f"/calibrations/{steeper['id']}", curator)


def test_home_shows_a_visitor_what_is_public_of_sequences_and_boards(
    reading: Reading, platform: Platform, curator: Person
) -> None:
    grid = np.zeros(SHAPE, np.uint8)
    grid[118:138, 118:138, 10] = 1
    labelled(platform, curator, "forest", [grid])
    board = boarding(reading.client, platform)
    before = reading.html("/")
    assert "forest" not in before
    assert board.team not in before
    with platform.database.transaction() as session:
        session.execute(update(SequenceRow).values(is_public=True))
        session.execute(update(Benchmark).values(is_public=True))
    after = reading.html("/")
    assert "forest" in after
    assert "data-viewer" in after
    assert re.search(r'<a class="harm-tag" data-harm="wrong" href="/codes/LAB-605"', after)
    assert board.team in after


def cards(reading: Reading, query: str = "", who: Person | None = None) -> list[str]:
    """The names on the cards of the list of sequences, in their order."""
    html = reading.html(f"/sequences{query}", who)
    return re.findall(r'<a href="/sequences/[0-9a-f]{32}">([^<]+)</a></h', html)


@pytest.mark.whole
def test_the_list_of_sequences_is_filtered_paged_and_of_what_may_be_seen(
    reading: Reading, platform: Platform, curator: Person
) -> None:
    listed_world(platform, reading.client, curator)
    named = [name for name in cards(reading, "", curator)]
    assert len(named) == 6
    assert cards(reading, "?environment=lake", curator) == [name for name in named if name.startswith("lake")]
    assert cards(reading, "?name=LAKE-2", curator) == [name for name in named if name.startswith("lake")]
    assert cards(reading, "?name=la_e", curator) == []
    assert len(cards(reading)) == 1, "a visitor sees the public one"
    page = reading.html("/sequences", curator)
    assert "traversable 10.0 %" in page
    assert "sequence-split" in page
    assert "sequence-split" not in reading.html("/sequences")
    for number in range(25):
        made.sequence(reading.client, curator, f"run-{number:02}")
    first = reading.html("/sequences?name=run", curator)
    assert len(cards(reading, "?name=run", curator)) == 24
    (older,) = re.findall(r'rel="next" href="/sequences([^"]+)"', first)
    assert cards(reading, older.replace("&amp;", "&"), curator) == ["run-00"]


@pytest.mark.whole
def test_the_pages_of_a_sequence_tell_its_figures_findings_clocks_and_cameras(
    reading: Reading, platform: Platform, curator: Person
) -> None:
    shown = whole_sequence(platform, curator)
    base = f"/sequences/{shown['id']}"
    overview = reading.html(base, curator)
    assert re.search(r'data-harm="wrong"><a class="code" href="/codes/LAB-603">', overview)
    harmless = overview.partition('<details class="harmless">')[2].partition("</details>")[0]
    assert 'data-harm="none"' in harmless
    assert "TIM-201" in harmless
    assert re.search(r"<dt>Held-out track</dt><dd>97.3 %</dd>", overview)
    by_distance = overview.partition('aria-label="Held-out track by distance"')[2].partition("</table>")[0]
    assert re.findall(r"<td[^>]*>([^<]*)</td>", by_distance) == ["300", "90.0 %", "100", "20.0 %"]
    assert re.search(
        r'<a class="harm-tag" data-harm="wrong" href="/codes/LAB-605"', reading.html("/sequences", curator)
    )
    recordings = reading.text(f"{base}/recordings", curator)
    for said in ("−37 s", "TAI-UTC", "-0.080000 s", "0.41 ms", "camera motion"):
        assert said in recordings, said
    page = reading.html(f"{base}/recordings", curator)
    assert 'aria-label="Quality 78 of 100"' in page
    assert page.count('class="spoke-gap"') == 1
    rig = re.findall(r"<figcaption>([^<]+)</figcaption>", reading.html(f"{base}/calibration", curator))
    assert rig == ["front left", "front", "front right", "back left", "back", "back right"]
    assert "SYN-504" in reading.html(f"{base}/track", curator)


STAGES = ("ingest.synchronise", "labeler.fuse", "labeler.surface")
PARTS = ("", "/frames", "/track", "/recordings", "/calibration", "/processing", "/label-sets", "/exports")


def fail_at_the_surface(platform: Platform, run_id: str) -> None:
    """As workers would write it down: the first stage is done, the second stopped, the third failed with a line."""
    at_ns = now_ns()
    states = {"ingest.synchronise": "succeeded", "labeler.fuse": "cancelled", "labeler.surface": "failed"}
    with platform.database.transaction() as session:
        for row in session.scalars(select(Job).where(Job.root_id == run_id)):
            row.state = states.get(row.kind, "failed")
            row.started_ns, row.finished_ns, row.revision = at_ns - 9 * 10**9, at_ns, row.revision + 1
            if row.state == "failed":
                row.failure_code, row.failure = "surface_empty", "no point survived carving"
            if row.kind == "labeler.surface":
                session.add(JobAttempt(job_id=row.id, number=1, worker="w:1", outcome="failed", started_ns=at_ns))
                session.flush()
                line = JobLine(job_id=row.id, attempt=1, number=0, level="error", event="the tile has no surface")
                session.add(line)


@pytest.mark.whole
def test_a_failed_rerun_is_said_on_every_part_and_never_to_visitors(
    reading: Reading, platform: Platform, curator: Person
) -> None:
    shown = whole_sequence(platform, curator)
    base = f"/sequences/{shown['id']}"
    publish(platform, shown["id"])
    fail_at_the_surface(platform, made.run(platform, curator, *STAGES, sequence_id=shown["id"]))
    for part in PARTS:
        assert "surface_empty" in reading.html(base + part, curator), part
    steps = reading.html(f"{base}/processing", curator).partition('class="run-steps')[2].partition("</ol>")[0]
    assert set(re.findall(r'<li data-state="(\w+)"', steps)) == {"succeeded", "cancelled", "failed"}
    assert "re-run failed" in reading.text("/sequences", curator)
    for path in (base, "/sequences"):
        assert "surface_empty" not in reading.html(path)
        assert "re-run failed" not in reading.html(path)


@pytest.mark.whole
@pytest.mark.parametrize("kind", ["labeler.export", "eval.compare"])
def test_what_is_made_of_labels_is_no_state_of_the_sequence(
    reading: Reading, platform: Platform, curator: Person, kind: str
) -> None:
    shown = whole_sequence(platform, curator)
    with platform.database.transaction() as session:
        for state in ["failed"] * 14 + ["queued"]:  # more than the page lists
            job = Job(owner_id=curator.user_id, sequence_id=shown["id"], kind=kind, queue=kind.partition(".")[0])
            job.id = job.root_id = made.new_id()
            job.state = state
            session.add(job)
    listed = reading.client.get(f"/api/v1/sequences/{shown['id']}", headers=curator.headers).json()
    assert listed["job"]["kind"] == "sequence.process"
    page = reading.html(f"/sequences/{shown['id']}/processing", curator)
    assert '<span id="word" class="row"><span class="state" data-state="labelled">' in page
    assert "Cancel this run" not in page


def test_an_owner_is_offered_profile_field_where_it_helps_and_the_form_keeps_what_was_asked_for(
    reading: Reading, platform: Platform, curator: Person, participant: Person
) -> None:
    shown = whole_sequence(platform, curator)
    base = f"/sequences/{shown['id']}"
    publish(platform, shown["id"])
    offers = re.compile(r'href="(/sequences/[0-9a-f]+/processing\?[^"]+)"')
    offered = offers.search(reading.html(base, curator))
    assert offered
    assert offered[1].endswith("?profile=field#process")
    for somebody in (None, participant):
        assert not offers.search(reading.html(base, somebody))
    for report in ({**REPORT, "parameters": {"profile": "field"}}, {**REPORT, "findings": REPORT["findings"][:1]}):
        replace_files(platform, shown["label_set_id"], {"report.json": json.dumps(report).encode()})
        assert not offers.search(reading.html(base, curator))
    assert "data-kept" not in reading.html(f"{base}/processing", curator)


SCENE = SyntheticDataset(scenes=1, cameras=("CAM_FRONT",), labels=[made_labels()])


@pytest.mark.whole
def test_an_imported_sequence_is_shown_without_a_recording(
    reading: Reading, platform: Platform, curator: Person, tmp_path: Path
) -> None:
    tar = write_published_tar(tmp_path / "field.tar", SCENE)
    bring_dataset(platform, tar, curator.user_id)
    run_all(platform)
    with platform.database.reading() as session:
        sequence_id = session.scalars(select(SequenceRow.id)).one()
    base = f"/sequences/{sequence_id}"
    sections = {section: reading.html(base + section, curator) for section in (*PARTS, "/view")}
    assert sha256(tar.read_bytes()).hexdigest() in sections[""]
    assert SCENE.tokens(0)[0] in sections["/frames"]
    assert "Start processing" not in sections["/processing"]
    assert "data-viewer" in sections["/view"]
    scene = reading.client.get(f"/api/v1{base}/scene", headers=curator.headers)
    assert (scene.status_code, scene.json()["reference"]) == (200, None)
    for name in ("labels.npz", "voxels", "bev.png"):
        path = f"/api/v1/frames/{SCENE.tokens(0)[1]}/{name}"
        assert reading.client.get(path, headers=curator.headers).status_code == 200, name


def test_every_code_has_a_page_with_its_meaning_its_harm_and_its_remedy(reading: Reading) -> None:
    for code, one in CATALOGUE.items():
        text = reading.html(f"/codes/{code}").replace("&#39;", "'").replace("&gt;", ">")
        assert one.meaning in text
        assert one.remedy in text
        assert HARM_WORDS[one.harm] in text


@pytest.mark.whole
def test_the_dataset_page_tells_a_versions_composition_and_withholds_classes_of_test(
    reading: Reading, platform: Platform, administrator: Person, curator: Person, participant: Person
) -> None:
    sequences = campaign(platform, curator)
    parts = {"train": [one.id for one in sequences[:9]], "val": [sequences[9].id], "test": [sequences[12].id]}
    published.dataset(platform, administrator.user_id, parts, "stone-1.0")
    page = reading.html("/dataset", participant)
    assert "stone-1.0" in page
    assert page.count('class="square"') == 11
    assert "classes withheld" in page
    assert page.count("97.3 % of 75 m") == 10, "of train and val alone"


def test_a_curator_reads_of_their_own_sequences_in_which_parts_they_are(
    reading: Reading, platform: Platform, curator: Person
) -> None:
    sequences = [driven(platform, curator, number) for number in range(3)]
    other = person(platform, "curator")
    own = driven(platform, other, 0)
    put(platform, Split(train=(own.id, sequences[0].id, sequences[1].id), val=(sequences[2].id,), test=()))
    said = reading.text("/dataset/splits", other)
    assert "Your sequences: 1 in train, 0 in val, 0 in test." in said
    assert "All sequences: 3 in train, 1 in val, 0 in test." in said
    page = reading.html("/dataset/splits", other)
    assert own.id in page
    assert sequences[0].id not in page


WHEEL = ClientWheel(FILENAME, bytes(range(256)) * 400)


@pytest.fixture
def offering(platform: Platform, monkeypatch: pytest.MonkeyPatch) -> Iterator[Reading]:
    """A site that has a wheel to offer."""
    monkeypatch.setattr("api.main.client_wheel", lambda: WHEEL)
    with reading_of(platform) as made:
        yield made


def test_the_clients_wheel_is_offered_and_served_whole_and_in_parts_and_no_other_file(offering: Reading) -> None:
    page = offering.html("/downloads/")
    assert f"pip install {offering.platform.settings.api.url}/downloads/{FILENAME}" in page
    assert WHEEL.sha256 in page
    answer = offering.client.get(f"/downloads/{FILENAME}")
    assert (answer.status_code, sha256(answer.content).hexdigest()) == (200, WHEEL.sha256)
    part = offering.client.get(f"/downloads/{FILENAME}", headers={"Range": "bytes=100-199"})
    assert (part.status_code, part.content) == (206, WHEEL.content[100:200])
    for name in ("stone_client-0.0.1-py3-none-any.whl", "..%2Fclient_wheel.py", "client_wheel.py"):
        assert offering.client.get(f"/downloads/{name}").status_code == 404


@pytest.mark.whole
@pytest.mark.parametrize("role", ROLES[1:])
def test_the_first_steps_of_each_role_lead_to_pages_that_it_may_see(reading: Reading, role: str) -> None:
    somebody = person(reading.platform, role)
    steps = reading.html("/", somebody).partition("first-steps")[2].partition("</main>")[0]
    paths = [path for path in re.findall(r'<a href="(/[^"]*)"', steps) if not path.startswith("/docs")]
    assert paths
    assert {path: reading.status(path, somebody) for path in paths} == dict.fromkeys(paths, 200)


@pytest.mark.whole
def test_first_steps_are_gone_where_all_is_done_and_lead_to_ones_own_sequence(
    reading: Reading, platform: Platform
) -> None:
    world = benchmark_world(platform, frames=1)
    curator = person(platform, "curator")
    sequence_id = new_sequence(platform, curator)["id"]
    with platform.database.transaction() as session:
        entered = {"phase_id": world.val, "team_id": world.teams[0], "user_id": world.captains[0].user_id}
        session.add(SubmissionRow(**entered, method="Net", modality="L", declared_sha256="0" * 64, size_bytes=1))
    assert "first-steps" not in reading.html("/", world.captains[0])
    assert "first-steps" in reading.html("/", person(platform, "participant"))
    assert f'<a href="/sequences/{sequence_id}">' in reading.html("/", curator)


@pytest.fixture
def manual(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "manual"
    (folder / "reference").mkdir(parents=True)
    (folder / "index.html").write_text("<!doctype html><title>Docs</title>")
    (folder / "site.css").write_text("h1 { color: rgb(1, 2, 3); }")
    (folder / "reference" / "index.html").write_text("<!doctype html><title>Reference</title>")
    monkeypatch.setattr(docs, "MANUAL", folder)
    return folder


def test_a_folder_of_the_manual_is_its_index_and_what_did_not_change_is_not_sent_again(
    reading: Reading, manual: Path
) -> None:
    client = reading.client
    assert "Reference" in client.get("/docs/reference/").text
    sheet = client.get("/docs/site.css")
    assert sheet.headers["content-type"].startswith("text/css")
    assert client.get("/docs/site.css", headers={"If-None-Match": sheet.headers["etag"]}).status_code == 304


def test_nothing_outside_the_manual_is_sent(reading: Reading, manual: Path) -> None:
    (manual.parent / "secret").write_text("nobody's")
    (manual / "link").symlink_to(manual.parent / "secret")
    outside = ("..%2fsecret", "%2e%2e/secret", "/etc/passwd", "%00", "link", "reference%2f..%2f..%2fsecret", "a" * 3000)
    for path in outside:
        answer = reading.answer(f"/docs/{path}")
        assert answer.status_code in (401, 404), path  # a visitor is asked to sign in
        assert "nobody's" not in answer.text


@pytest.mark.parametrize("path", ["/sign-in", "/account"])
def test_on_loopback_the_file_of_the_first_password_is_told_and_never_the_password(path: str, reading: Reading) -> None:
    assert PASSWORD_FILE not in reading.answer(path).text, "there is none yet"
    password = ensure_keys(reading.platform).password
    text = reading.answer(path).text
    assert str(reading.platform.settings.root / PASSWORD_FILE) in text
    assert password
    assert password not in text


def test_a_reader_elsewhere_is_not_told_where_the_first_password_is(
    reading: Reading, settings: Settings, bells: Bells
) -> None:
    ensure_keys(reading.platform)
    for name, value in (("Host", "stone.example"), ("Host", "10.0.0.1"), ("X-Forwarded-For", "192.0.2.7")):
        answer = reading.client.get("/sign-in", headers={name: value})
        assert answer.status_code == 200
        assert PASSWORD_FILE not in answer.text
    named = opened(settings.model_copy(update={"api": ApiSettings(url="https://stone.example")}), bells)
    with reading_of(named) as elsewhere:
        assert PASSWORD_FILE not in elsewhere.html("/sign-in")
    named.database.close()


@pytest.mark.parametrize("back", ["//elsewhere.example/", "/\\elsewhere.example", "https://elsewhere.example/"])
def test_signing_in_never_leads_to_another_host(reading: Reading, back: str) -> None:
    assert 'data-then="goto:/"' in reading.html(f"/sign-in?back={back}")


@pytest.mark.whole
def test_a_fault_of_ours_is_a_page_with_nothing_of_our_insides(
    reading: Reading, curator: Person, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("web.pages.home.viewer_for", lambda *_: {}["a secret of ours"])
    answer = reading.answer("/", curator)
    assert answer.status_code == 500
    assert answer.headers["content-type"].startswith("text/html")
    assert "secret" not in answer.text
