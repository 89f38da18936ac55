"""Bags come in at a page: chosen, counted, sent, read; refused with reasons where they cannot."""

import shutil
from base64 import b64encode
from pathlib import Path
from typing import Any

import httpx
from playwright.sync_api import Browser, Page, expect
from sqlalchemy import select

from services.ingest.queue_handlers import handlers
from services.runtime.orm import CalibrationRow, SequenceRow
from services.runtime.platform import Platform
from simulator.pipeline import calibration_path
from stone.errors import StoneError
from stone_files.bag_fingerprint import check_bag_files, is_bag_part
from stone_recordings.bags.errors import CutBagError, NotABagError
from stone_recordings.bags.magic import container_of
from testing.api.serving import Person, serving
from testing.servers.fixtures import having
from testing.web.browsing import Site
from testing.worlds.made import sequence
from testing.worlds.ros1_bags import as_ros1
from tests.stone_recordings.splitting import split_into
from tests.web.bringing import bag, choose, moved, recordings, row_of, uploads
from tests.working import working
from web.main import make_site


def test_bags_of_several_kinds_become_sequences_of_their_own_or_one_of_a_name_given_to_two(
    site: Site, curator: Person, tmp_path: Path
) -> None:
    day = tmp_path / "field day"
    split = day / "run 7"
    split.mkdir(parents=True)
    split_into(bag(), split, 3)
    for name in ("lidar.mcap", "cameras.mcap"):
        shutil.copy(bag(), day / name)
    as_ros1(bag(), day / "older.bag", "lz4")
    (day / "rig.yaml").write_text("sensors: {}")
    (day / "notes.txt").write_text("windy")
    with site.visit(curator, expected=["422"]) as page, working(site.platform, "ingest", handlers):
        page.goto("/sequences/new")
        page.locator("[data-folder]").set_input_files(day)
        expect(page.locator(".transfer")).to_have_count(4)
        expect(row_of(page, "run 7").get_by_label("Sequence")).to_have_value("run-7")
        for name in ("lidar.mcap", "cameras.mcap"):
            row_of(page, name).get_by_label("Sequence").fill("hill-4")
        page.get_by_label("Environment").fill("mountain")
        expect(page.get_by_text("2 files were left out")).to_be_visible()
        expect(page.locator("[data-left-list]")).to_contain_text("rig.yaml: Not a valid calibration. CAL-")
        page.get_by_role("button", name="Upload 4 bags").click()
        for name in ("run 7", "lidar.mcap", "cameras.mcap", "older.bag"):
            expect(row_of(page, name).locator("[data-phase]")).to_have_text("registered", timeout=300_000)
        row_of(page, "lidar.mcap").get_by_role("link", name="Open the sequence").click()
        expect(page.get_by_role("heading", name="hill-4")).to_be_visible()
    kept = {row.filename: [file.filename for file in row.files] for row in recordings(site.platform)}
    assert len(kept.pop("run 7")) >= 3
    assert kept == {name: [name] for name in ("lidar.mcap", "cameras.mcap", "older.bag")}
    sequence_of = {row.filename: row.sequence_id for row in recordings(site.platform)}
    assert sequence_of["lidar.mcap"] == sequence_of["cameras.mcap"]
    assert len(set(sequence_of.values())) == 3


def test_what_cannot_be_taken_says_why_beside_its_line_and_no_byte_is_sent_of_what_is_no_bag(
    site: Site, curator: Person, tmp_path: Path
) -> None:
    login, junk = tmp_path / "run.mcap", tmp_path / "junk.mcap"
    login.write_text("<!DOCTYPE html><title>Sign in</title>" * 100)
    junk.write_bytes(b"\x89MCAP0\r\n" + b"this is no recording " * 50)
    with httpx.Client(base_url=site.url) as api:
        sequence(api, curator, "junk")
    asked: list[str] = []
    with site.visit(curator, expected=["409"]) as page, working(site.platform, "ingest", handlers):
        page.goto("/sequences/new")
        page.on("request", lambda request: asked.append(request.method))
        choose(page, login)
        row = row_of(page, "run.mcap")
        expect(row.locator("[data-phase]")).to_have_text("refused")
        expect(row.locator(".finding")).to_contain_text("BAG-001")
        expect(row.get_by_role("button", name="Try again")).to_be_hidden()
        expect(page.get_by_role("button", name="Upload")).to_be_disabled()
        row.get_by_role("button", name="Remove").click()
        expect(row).to_have_count(0)
        assert not {"POST", "PATCH"} & set(asked)
        choose(page, junk)
        page.get_by_role("button", name="Upload").click()
        row = row_of(page, "junk.mcap")
        expect(row.locator(".finding")).to_contain_text("name_taken")
        row.get_by_label("Sequence").fill("junk-2")
        row.get_by_role("button", name="Try again").click()
        expect(row.locator("[data-phase]")).to_have_text("refused", timeout=300_000)
        expect(row.locator(".finding").first).to_contain_text("BAG-")
    assert [row.state for row in recordings(site.platform)] == ["refused"]


def test_a_bag_and_its_calibration_come_in_one_drop(site: Site, curator: Person, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    shutil.copy(bag(), folder / "run.mcap")
    shutil.copy(calibration_path(bag()), folder / "spot.yaml")
    with site.visit(curator) as page:
        page.goto("/sequences/new")
        process = page.get_by_label("Process each sequence")
        expect(process).to_be_disabled()
        page.locator("[data-folder]").set_input_files(folder)
        expect(row_of(page, "spot.yaml").locator(".state")).to_have_text("added")
        expect(row_of(page, "spot.yaml")).to_contain_text("Assigned.")
        expect(process).to_be_checked()
        page.get_by_role("button", name="Upload").click()
        expect(row_of(page, "run.mcap").locator("[data-phase]")).to_have_text("reading")
    with site.platform.database.reading() as session:
        kept = session.scalars(select(CalibrationRow)).one()
        assert session.scalars(select(SequenceRow)).one().calibration_id == kept.id


def test_a_calibration_that_is_dropped_at_a_sequence_is_assigned_unless_it_has_one(
    site: Site, curator: Person, tmp_path: Path
) -> None:
    own = calibration_path(bag())
    with httpx.Client(base_url=site.url) as api:
        made = sequence(api, curator, "forest")
    with site.visit(curator) as page:
        page.goto(f"/sequences/{made['id']}")
        choose(page, own)
        expect(row_of(page, own.name)).to_contain_text("Assigned.")
        page.reload()
        choose(page, moved(own, tmp_path / "other.yaml", 0.01))
        expect(row_of(page, "other.yaml")).to_contain_text("Not assigned")
    with site.platform.database.reading() as session:
        first, _ = session.scalars(select(CalibrationRow).order_by(CalibrationRow.id)).all()
        assert session.scalars(select(SequenceRow)).one().calibration_id == first.id


def test_no_robots_calibration_is_chosen_but_the_one_last_used_with_it(
    site: Site, curator: Person, tmp_path: Path
) -> None:
    with httpx.Client(base_url=site.url, headers=curator.headers) as api:
        ids = {}
        for robot, by_m in (("spot", 0.01), ("husky", 0.02)):
            path = moved(calibration_path(bag()), tmp_path / f"{robot}.yaml", by_m)
            ids[robot] = api.post("/api/v1/calibrations", files={"file": (path.name, path.read_bytes())}).json()["id"]
            made = sequence(api, curator, f"run-{robot}", platform=robot)
            api.put(f"/api/v1/sequences/{made['id']}/calibration", json={"calibration_id": ids[robot]})
    with site.visit(curator) as page:
        page.goto("/sequences/new")
        calibration = page.get_by_label("Calibration", exact=False).and_(page.locator("select"))
        expect(calibration).to_have_value("")
        page.get_by_label("Robot").fill("spot")
        expect(calibration).to_have_value(ids["spot"])
        expect(page.get_by_text("last used with spot")).to_be_visible()
        page.get_by_label("Robot").fill("another")
        expect(calibration).to_have_value("")
        calibration.select_option(ids["husky"])
        page.get_by_label("Robot").fill("spot")
        expect(calibration).to_have_value(ids["husky"])


def test_the_same_bag_is_neither_sent_nor_kept_twice(site: Site, curator: Person) -> None:
    with httpx.Client(base_url=site.url) as api:
        made = sequence(api, curator, "forest")
    with site.visit(curator) as page, working(site.platform, "ingest", handlers):
        for _ in range(2):
            page.goto(f"/sequences/new?again={_}")
            page.goto(f"/sequences/{made['id']}/recordings")
            choose(page, bag())
            expect(row_of(page, "run.mcap").locator("[data-phase]")).to_have_text("registered", timeout=300_000)
    assert len(recordings(site.platform)) == len(uploads(site.platform)) == 1


NAMES = (
    "run.mcap", "RUN.MCAP", "run.db3", "run_0.db3.zstd", "run.db3-wal", "run.db3-journal", "other.db3-wal", ".mcap",
    "metadata.yaml", "Metadata.yaml", "my_msgs.Reading.msg", "my_msgs.reading.msg", "notes.txt", "run.bag", "mcap",
    "run.bag.active", "run_0.bag.zstd", "run.bag-wal", "run.active",
)  # fmt: skip
LISTS = (
    ["run_0.mcap", "run_1.mcap"], ["run.mcap", "metadata.yaml"], ["run.mcap", "RUN.mcap"], ["run.db3", "run.mcap"],
    ["metadata.yaml", "my_msgs.Reading.msg"], ["run.db3", "run.db3-wal"], ["run.db3", "other.db3-wal"],
    ["a.mcap", "b.mcap.zstd"], [f"run_{number}.db3" for number in range(512)],
    [f"run_{number}.db3" for number in range(513)], ["run_0.bag", "run_1.bag.active"], ["run_0.bag", "run_1.mcap"],
)  # fmt: skip
GROUPED: tuple[tuple[list[str], dict[str, int]], ...] = (
    (["run.mcap"], {"run.mcap": 1}),
    (["a.mcap", "b.mcap"], {"a.mcap": 1, "b.mcap": 1}),
    (["run_0.mcap", "run_1.mcap"], {"run": 2}),
    (["day/a.mcap", "day/b.db3"], {"a.mcap": 1, "b.db3": 1}),
    (["day/run/run_0.db3", "day/run/metadata.yaml", "day/x.mcap"], {"run": 2, "x.mcap": 1}),
    (["day/run/a.mcap", "day/run/b.mcap", "day/run/metadata.yaml"], {"run": 3}),
    (["day/metadata.yaml", "notes.txt"], {}),
    (["run.db3", "run.db3-wal"], {"run.db3": 2}),
    (["day/run_0.bag", "day/run_1.bag.active"], {"day": 2}),
    (["radar.bag", "run.mcap"], {"radar.bag": 1, "run.mcap": 1}),
)


def ask(page: Page, body: str, given: object, module: str = "bags") -> Any:
    """What a module of the page's own says."""
    built = page.evaluate("document.querySelector('script[src*=\"upload/mount.js\"]').src")
    built = built.replace("mount.js", f"{module}.js")
    return page.evaluate(f"async ([at, given]) => {{ const bags = await import(at); {body} }}", [built, given])


def is_refused(names: list[str]) -> bool:
    try:
        check_bag_files(names)
    except StoneError as error:
        if error.code != "bad_recording_files":
            raise
        return True
    return False


MCAP = b"\x89MCAP0\r\n"
HEADS = {
    "mcap": MCAP + b"\x01more",
    "cut mcap": MCAP[:5],
    "one byte": MCAP[:1],
    "damaged beginning": b"\0" * 600 + MCAP,
    "damaged beginning, zeros behind": b"\xff" * 9 + MCAP + b"\0" * 3_000_000,
    "zeros": b"\0" * 1_100_000,
    "sqlite": b"SQLite format 3\x00rest",
    "cut sqlite": b"SQLite format",
    "ros1": b"#ROSBAG V2.0\nrest",
    "cut ros1": b"#ROSBAG",
    "old ros1": b"#ROSBAG V1.2\n",
    "older ros1": b"#ROSRECORD V1.1\n",
    "nothing": b"",
    "zip": b"PK\x03\x04rest",
    "gzip": b"\x1f\x8b\x08",
    "lz4": b"\x04\x22\x4d\x18rest",
    "bzip2": b"BZh91AY",
    "xz": b"\xfd7zXZ\x00",
    "lfs": b"version https://git-lfs.github.com/spec/v1\n",
    "pcap": b"\xd4\xc3\xb2\xa1\x02",
    "pcapng": b"\x0a\x0d\x0d\x0a\x01",
    "elf": b"\x7fELF\x02",
    "tar": b"a" * 257 + b"ustar" + b"b" * 250,
    "html": b"<!doctype HTML><title>Sign in</title>",
    "html after spaces": b"\r\n\t <HTML>",
    "html within": b"<!-- saved --><html>",
    "xml": b"<?xml version='1.0'?>",
    "tag": b" <bag>",
    "json": b'\n{"error": 403}',
    "list": b"[]",
    "text": b"this is no bag\n" + "Größe".encode(),
    "bytes": b'\x00\x01\x02\x03 and "quotes"',
    "text with a null": b"plain\0text",
}


def refusal(path: Path) -> str:
    """The platform's."""
    try:
        container_of(path)
    except NotABagError as refused:
        return str(refused)
    except CutBagError:
        return ""
    return ""


def test_the_page_and_the_platform_agree_on_what_a_bag_is_by_names_and_by_first_bytes(
    site: Site, curator: Person, tmp_path: Path
) -> None:
    """What only the platform can tell, whether a bag is inside of a file compressed with zstd, the page lets pass."""
    with site.visit(curator) as page:
        page.goto("/sequences/new")
        parts = ask(page, "return given.map(bags.isBagPart)", NAMES)
        assert dict(zip(NAMES, parts, strict=True)) == {name: is_bag_part(name) for name in NAMES}
        troubles = ask(page, "return given.map(names => bags.troubleOf(names) !== '')", LISTS)
        assert troubles == [is_refused(list(names)) for names in LISTS]
        body = """return given.map(paths => Object.fromEntries(bags.sorted(paths.map(path =>
          ({path, file: new File(['x'], path.split('/').at(-1))}))).bags.map(bag => [bag.name, bag.files.length])))"""
        found = ask(page, body, [paths for paths, _ in GROUPED])
        assert found == [expected for _, expected in GROUPED]
        body = """const bytes = (text) => Uint8Array.from(atob(text), (one) => one.charCodeAt(0));
          const [files, hasWal, name] = given;
          const file = (text, n) => new File([bytes(text)], `${n}.${name}`);
          return Promise.all(files.map((text, n) => bags.refusalOf(file(text, n), hasWal)));"""
        encoded = [b64encode(content).decode() for content in HEADS.values()]
        for has_wal in (False, True):
            expected = refusals(tmp_path, has_wal)
            said = ask(page, body, [encoded, has_wal, "db3"], "magic")
            assert dict(zip(HEADS, said, strict=True)) == expected
            assert sum(map(bool, expected.values())) > 20
        assert ask(page, body, [[b64encode(b"\x28\xb5\x2f\xfd\0").decode()], False, "mcap"], "magic") == [""]


def refusals(folder: Path, has_wal: bool) -> dict[str, str]:
    """What the platform says of each of `HEADS`; empty where it refuses nothing, or only what is cut."""
    said = {}
    for number, (name, content) in enumerate(HEADS.items()):
        path = folder / f"{number}.db3"
        path.write_bytes(content)
        if has_wal:
            path.with_name(f"{number}.db3-wal").write_bytes(b"x")
        said[name] = refusal(path)
    return said


def test_a_bag_that_the_server_sees_is_named_instead_of_sent(
    platform: Platform, browser: Browser, curator: Person, tmp_path: Path
) -> None:
    placed = having(platform, in_place={"folders": f"nas={tmp_path}"})
    shutil.copy(bag(), tmp_path / "run.mcap")
    with serving(placed, make_site(placed)) as url, working(placed, "ingest", handlers):
        with httpx.Client(base_url=url) as api:
            made = sequence(api, curator, "hill")
        with Site(url, placed, browser).visit(curator, expected=["422"]) as page:
            page.goto(f"/sequences/{made['id']}/recordings")
            panel = page.locator("#in-place")
            panel.get_by_label("Path below it").fill("../run.mcap")
            panel.get_by_role("button", name="Add").click()
            expect(panel.locator(".said")).to_contain_text("not a path within a root")
            panel.get_by_label("Path below it").fill("run.mcap")
            panel.get_by_role("button", name="Add").click()
            expect(page.get_by_text("nas:run.mcap")).to_be_visible()
    assert [row.place and row.place["path"] for row in recordings(placed)] == ["run.mcap"]
    assert uploads(placed) == []
