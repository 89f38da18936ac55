"""Recordings arrive whole whatever ends in between: a folder of files, several recordings of a run, one large file.

Catches alone a file that is missing or sent twice after something ended in between, and parts of a bag kept apart.
"""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path

import pytest
import typer
from sqlalchemy import func, select

from services.runtime.orm import Job, QuotaEntry, Recording, Upload
from services.runtime.platform import Platform
from services.runtime.uploads import upload_file as stored_file
from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate
from stone_client.api import Api
from stone_client.clock_offsets import chosen_clock_offsets
from stone_client.credentials import Server
from stone_client.files import parallel, tus
from stone_client.files.bags import bags_among, called, hashed_bag
from stone_client.files.tus import Purpose, hashed, upload_file
from stone_client.server.sequences import add_recording, ensure_sequence, has_other_recording
from stone_files.bag_fingerprint import recording_sha256
from testing.api.process import ApiProcess, running_api
from testing.api.serving import Person, serving
from testing.refusals import refused_as
from testing.servers.fixtures import having
from testing.stone_serve import until
from testing.worlds.recording_parts import RecordingPart, split_into
from tests.stone_client.participating import ingesting, quiet, refused, stone
from tests.stone_recordings.splitting import split_into as split_evenly

pytestmark = pytest.mark.whole


@pytest.fixture
def calibration(bag: Path) -> Path:
    return calibration_path(bag)


@pytest.fixture
def folder(bag: Path, tmp_path: Path) -> Path:
    """Three files of one bag, and a file that is no part of it."""
    folder = tmp_path / "run.2026"
    folder.mkdir()
    split_evenly(bag, folder, 3)
    (folder / "notes.txt").write_text("mud on the front camera")
    return folder


def uploads(platform: Platform) -> list[tuple[str, str]]:
    with platform.database.reading() as session:
        return sorted((row.filename, row.state) for row in session.scalars(select(Upload)))


def test_a_folder_is_one_recording_of_its_files(
    platform: Platform, as_owner: str, folder: Path, calibration: Path
) -> None:
    with ingesting(platform):
        sent = stone("sequence", "upload", folder, "--calibration", calibration, "--name", "forest", "--json")
        again = stone("sequence", "upload", folder, "--calibration", calibration, "--name", "forest", "--json")
    assert (sent.exit_code, again.exit_code) == (0, 0), sent.stderr + again.stderr
    assert json.loads(sent.stdout)["recording"] == json.loads(again.stdout)["recording"]
    assert uploads(platform) == [(f"run_{number}.mcap", "consumed") for number in range(3)]
    with platform.database.reading() as session:
        recording = session.scalars(select(Recording)).one()
        taken_bytes = session.scalar(select(func.sum(QuotaEntry.amount)).where(QuotaEntry.reason == "upload"))
    assert (recording.filename, recording.state) == ("run.2026", "registered")
    assert recording.sha256 == recording_sha256(folder)
    assert taken_bytes == recording.size_bytes == sum(path.stat().st_size for path in folder.glob("*.mcap"))


def test_a_folder_goes_on_with_the_file_at_which_it_was_interrupted(
    platform: Platform, url: str, owner: Person, folder: Path
) -> None:
    bag = hashed_bag(folder, quiet)

    def interrupt(stage: str, done: int, total: int) -> None:
        assert total == bag.size_bytes
        if stage == "upload" and done >= bag.files[0].size_bytes + bag.files[1].size_bytes:
            raise KeyboardInterrupt

    with Api(Server(url, owner.secret)) as api:
        sequence = ensure_sequence(api, "forest")
        with pytest.raises(KeyboardInterrupt):
            add_recording(api, sequence, bag, interrupt)
        before = uploads(platform)
        assert before[:2] == [("run_0.mcap", "complete"), ("run_1.mcap", "complete")]
        with ingesting(platform):
            made = add_recording(api, sequence, bag, quiet)
        assert made["state"] == "registered"
        assert not has_other_recording(api, sequence, bag)
    assert uploads(platform) == [(f"run_{number}.mcap", "consumed") for number in range(3)]


def test_a_folder_without_a_bag_is_refused_before_anything_is_asked(
    as_owner: str, calibration: Path, tmp_path: Path
) -> None:
    (tmp_path / "empty").mkdir()
    with refused_as("bad_recording_files"):
        hashed_bag(tmp_path / "empty", quiet)
    assert (
        refused(stone("sequence", "upload", tmp_path / "empty", "--calibration", calibration)) == "bad_recording_files"
    )
    for name in ("a.mcap", "b.db3"):
        (tmp_path / "empty" / name).write_text(name)
    assert (
        refused(stone("sequence", "upload", tmp_path / "empty", "--calibration", calibration)) == "bad_recording_files"
    )


def test_a_bag_is_called_after_its_folder_or_its_one_file(folder: Path, tmp_path: Path) -> None:
    assert (hashed_bag(folder, quiet).name, called(folder)) == ("run.2026", "run.2026")
    (tmp_path / "alone").mkdir()
    (tmp_path / "alone" / "run_0.mcap").write_text("x")
    assert (hashed_bag(tmp_path / "alone", quiet).name, called(tmp_path / "alone")) == ("run_0.mcap", "alone")
    assert called(tmp_path / "alone" / "run_0.mcap") == "run_0"


TINY = SimulateOptions(seconds=1.0, channels=16, columns=120, cameras=False)
CUT_NS = 1_749_718_801_000_000_000


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ...]:
    """The LiDAR in two files whose names count on, the INS in another."""
    folder = tmp_path_factory.mktemp("several")
    simulate(folder / "whole.mcap", TINY)

    def is_ins(topic: str, _time_ns: int) -> bool:
        return topic.startswith("/novatel/")

    parts = (
        RecordingPart("run_0.mcap", lambda topic, ns: not is_ins(topic, ns) and ns < CUT_NS),
        RecordingPart("run_1.mcap", lambda topic, ns: not is_ins(topic, ns) and ns >= CUT_NS),
        RecordingPart("ins.mcap", is_ins),
    )
    return split_into(folder / "whole.mcap", folder, parts)


def names(*paths: Path) -> list[tuple[str, list[str]]]:
    return [(bag.name, [path.name for path in bag.paths]) for bag in bags_among(paths)]


def test_files_whose_names_count_on_are_one_bag_and_others_are_their_own(tmp_path: Path) -> None:
    (tmp_path / "split").mkdir()
    at = [tmp_path / name for name in ("run_0.mcap", "cams.mcap", "run_1.mcap", "ins_0.db3", "radar.bag", "split")]
    assert names(*at) == [
        ("run", ["run_0.mcap", "run_1.mcap"]), ("cams.mcap", ["cams.mcap"]), ("ins_0.db3", ["ins_0.db3"]),
        ("radar.bag", ["radar.bag"]), ("split", ["split"]),
    ]  # fmt: skip
    assert names(at[1], at[1]) == [("cams.mcap", ["cams.mcap"])]
    assert names(*(tmp_path / name for name in ("a.db3", "a.db3-wal", "b.mcap"))) == [
        ("a.db3", ["a.db3"]),
        ("b.mcap", ["b.mcap"]),
    ]
    whole = ("metadata.yaml", "x.mcap", "y.mcap")
    assert names(*(tmp_path / "split" / name for name in whole)) == [("split", list(whole))]
    assert bags_among((at[0], at[2]))[0].called == "run"
    assert bags_among((at[1],))[0].called == "cams"


def test_two_recordings_of_one_name_are_refused_before_anything_is_sent(tmp_path: Path) -> None:
    with refused_as("bad_recording_files"):
        bags_among((tmp_path / "lidar" / "run.mcap", tmp_path / "cameras" / "RUN.mcap"))


def test_several_recordings_of_a_run_go_to_one_sequence_and_are_processed_together(
    platform: Platform, as_owner: str, files: tuple[Path, ...]
) -> None:
    calibration = files[0].with_name("whole.calibration.yaml")
    with ingesting(platform):
        sent = stone("sequence", "upload", *files, "--calibration", calibration)
        again = stone("sequence", "upload", *files, "--calibration", calibration, "--json")
    assert (sent.exit_code, again.exit_code) == (0, 0), sent.stderr + again.stderr
    assert "run: run (2 files of one bag) is on" in sent.stdout
    assert "run: ins.mcap is on" in sent.stdout
    assert "2 recordings of one run: processing uses all of them on a common clock" in sent.stdout
    told = json.loads(again.stdout)
    assert [one["filename"] for one in told["recordings"]] == ["run", "ins.mcap"]
    with platform.database.reading() as session:
        rows = session.scalars(select(Recording).order_by(Recording.id)).all()
    assert [(row.filename, row.state, len(row.files)) for row in rows] == [
        ("run", "registered", 2),
        ("ins.mcap", "registered", 1),
    ]
    assert refused(stone("sequence", "process", "run", "--recording", "radar.mcap")) == "not_found"
    assert refused(stone("sequence", "process", "run", "--clock-offset", "radar.mcap=0.1")) == "bad_clock_offset"
    asked = stone("sequence", "process", "run", "--clock-offset", "ins.mcap=-0.08", "--json")
    assert asked.exit_code == 0, asked.stderr
    with platform.database.reading() as session:
        run = session.get_one(Job, json.loads(asked.stdout)["id"])
    assert run.arguments["recording_ids"] == [row.id for row in rows]
    assert run.arguments["clock_offsets_ns"] == {"ins.mcap": -80_000_000}


SIZE_BYTES = 24 * 2**20
RECORDING = Purpose("recording")
CLIENT = """
import sys
from pathlib import Path
import stone_client.files.tus
from stone_client.api import Api
from stone_client.clock_offsets import chosen_clock_offsets
from stone_client.credentials import Server
stone_client.files.tus.PIECE_BYTES = 2**16
path = Path(sys.argv[3])
with Api(Server(sys.argv[1], sys.argv[2])) as api:
    local = stone_client.files.tus.hashed(path, lambda *_: None)
    print(stone_client.files.tus.upload_file(api, local, stone_client.files.tus.Purpose("recording"), lambda *_: None))
"""


@pytest.fixture
def server(platform: Platform, tmp_path: Path) -> Iterator[ApiProcess]:
    with running_api(platform.settings, tmp_path / "api.log") as process:
        yield process


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "run é.mcap"
    path.write_bytes(os.urandom(SIZE_BYTES))
    return path


def sending(url: str, owner: Person, file: Path) -> subprocess.Popen[str]:
    """A client that sends the file in many small pieces."""
    command = [sys.executable, "-c", CLIENT, url, owner.secret, str(file)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def offset_of(api: Api) -> int:
    return sum(int(item["offset_bytes"]) for item in api.pages("/uploads"))


def test_a_client_that_is_killed_goes_on_where_it_was(platform: Platform, url: str, owner: Person, file: Path) -> None:
    with Api(Server(url, owner.secret)) as api:
        client = sending(url, owner, file)
        until(lambda: offset_of(api) > 2**20)
        client.kill()
        client.communicate()
        begun = offset_of(api)
        assert 2**20 < begun < SIZE_BYTES, "killed on its way"
        told: list[tuple[str, int, int]] = []
        upload_id = upload_file(api, hashed(file, quiet), RECORDING, lambda *said: told.append(said))
        assert begun <= told[0][1] < SIZE_BYTES, "it began where the killed one ended"
        assert told[-1] == ("upload", SIZE_BYTES, SIZE_BYTES)
        (only,) = api.pages("/uploads")
    assert (only["id"], only["state"], only["filename"]) == (upload_id, "complete", "run é.mcap")
    assert stored_file(platform.settings, upload_id).read_bytes() == file.read_bytes()
    assert only["sha256"] == sha256(file.read_bytes()).hexdigest()


def test_a_server_that_is_killed_and_comes_back_is_waited_for(
    platform: Platform, server: ApiProcess, owner: Person, file: Path
) -> None:
    """Catches alone a client that gives up, or sends twice, when the server is killed on its way."""
    with Api(Server(server.url, owner.secret)) as api:
        client = sending(server.url, owner, file)
        until(lambda: offset_of(api) > 2**20)
        server.kill()
        server.start()
        said, complaint = client.communicate(timeout=300)
        assert client.returncode == 0, complaint
    assert stored_file(platform.settings, said.strip()).read_bytes() == file.read_bytes()


def test_the_same_file_again_is_not_sent_again(url: str, owner: Person, file: Path) -> None:
    with Api(Server(url, owner.secret)) as api:
        local = hashed(file, quiet)
        first = upload_file(api, local, RECORDING, quiet)
        told: list[tuple[str, int, int]] = []
        assert upload_file(api, local, RECORDING, lambda *said: told.append(said)) == first
    assert told == [("upload", SIZE_BYTES, SIZE_BYTES)]


def test_an_empty_file_arrives_too(url: str, owner: Person, tmp_path: Path) -> None:
    (tmp_path / "empty.mcap").write_bytes(b"")
    with Api(Server(url, owner.secret)) as api:
        upload_id = upload_file(api, hashed(tmp_path / "empty.mcap", quiet), RECORDING, quiet)
        assert api.read(f"/uploads/{upload_id}")["state"] == "complete"


def test_a_file_that_is_still_being_written_is_refused(url: str, owner: Person, file: Path) -> None:
    local = hashed(file, quiet)
    with file.open("ab") as recorder:
        recorder.write(b"more")
    with Api(Server(url, owner.secret)) as api, refused_as("file_changed"):
        upload_file(api, local, RECORDING, quiet)


def test_a_recording_in_place_is_registered_once_and_nothing_is_sent(
    platform: Platform, owner: Person, bag: Path, calibration: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    placed = having(platform, in_place={"folders": f"nas={bag.parent.parent}"})
    place = f"nas:{bag.parent.name}/{bag.name}"
    with serving(placed) as url, ingesting(placed):
        monkeypatch.setenv("STONE_URL", url)
        monkeypatch.setenv("STONE_TOKEN", owner.secret)
        first = stone("sequence", "register", place, "--calibration", calibration, "--name", "forest", "--json")
        again = stone("sequence", "register", place, "--calibration", calibration, "--name", "forest", "--json")
        gone = stone("sequence", "register", "nas:nothing.mcap", "--calibration", calibration, "--name", "gone")
        other = stone("sequence", "register", "disk:run.mcap", "--calibration", calibration, "--name", "gone")
        unnamed = stone("sequence", "register", "run.mcap", "--calibration", calibration, "--name", "gone")
    assert (first.exit_code, again.exit_code) == (0, 0), first.stderr + again.stderr
    assert json.loads(first.stdout)["recordings"] == json.loads(again.stdout)["recordings"]
    assert [refused(one) for one in (gone, other, unnamed)] == ["recording_vanished", "unknown_root", "bad_place"]
    assert uploads(platform) == []


def test_a_large_file_comes_in_parts_side_by_side_and_goes_on_where_they_ended(
    platform: Platform, url: str, owner: Person, bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    size_bytes = bag.stat().st_size
    monkeypatch.setattr(parallel, "LEAST_PART_BYTES", size_bytes // 5)
    monkeypatch.setattr(tus, "PIECE_BYTES", size_bytes // 25)
    local, purpose = hashed(bag, quiet), Purpose("recording")
    told = list[int]()

    def interrupt(stage: str, done: int, total: int) -> None:
        assert (stage, total) == ("upload", size_bytes)
        if done > size_bytes // 2:
            raise KeyboardInterrupt
        told.append(done)

    with Api(Server(url, owner.secret)) as api:
        with pytest.raises(KeyboardInterrupt):
            parallel.upload_in_parts(api, local, purpose, interrupt)
        before = [upload for upload in rows(platform) if upload.purpose == "part"]
        assert 2 <= len(before) <= 5
        again = list[int]()
        upload_id = parallel.upload_in_parts(api, local, purpose, lambda _stage, done, _total: again.append(done))
        assert parallel.upload_in_parts(api, local, purpose, quiet) == upload_id
        other = parallel.upload_in_parts(api, hashed(bag, quiet), Purpose("recording", ""), quiet)
    assert other == upload_id
    assert max(again) == size_bytes
    parts = [upload for upload in rows(platform) if upload.purpose == "part"]
    assert {upload.id for upload in before} <= {upload.id for upload in parts}
    assert (len(parts), {upload.state for upload in parts}) == (5, {"consumed"})
    assert stored_file(platform.settings, upload_id).read_bytes() == bag.read_bytes()
    assert sum(path.stat().st_size for path in platform.settings.uploads_folder.iterdir()) == size_bytes


def rows(platform: Platform) -> list[Upload]:
    with platform.database.reading() as session:
        return list(session.scalars(select(Upload)))


@pytest.mark.parametrize(
    ("typed", "offset_ns"),
    [
        ("cameras.mcap=-0.080", -80_000_000),
        ("cameras.mcap=-80ms", -80_000_000),
        ("there/cameras.mcap=2s", 2_000_000_000),
        ("cameras.mcap=0.5us", 500),
        ("cameras.mcap=7ns", 7),
    ],
)
def test_an_offset_of_a_recording_has_a_unit_or_is_in_seconds(typed: str, offset_ns: int) -> None:
    assert chosen_clock_offsets([typed]) == {"cameras.mcap": offset_ns}


@pytest.mark.parametrize("typed", ["cameras.mcap", "=1s", "cameras.mcap=1h", "cameras.mcap=9999999999999s", "x=nan"])
def test_what_is_no_offset_is_refused(typed: str) -> None:
    with pytest.raises(typer.BadParameter, match="is not the clock offset of a recording"):
        chosen_clock_offsets([typed])
