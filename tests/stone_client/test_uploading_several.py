"""Several files named to `stone upload` are what a person means by them: parts of one bag, or recordings of one run.

Catches alone parts of a split bag that are kept as recordings, and recordings that are sealed together as one bag.
"""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from sqlalchemy import select
from structlog.testing import capture_logs

from services.runtime.orm import Job, Recording
from services.runtime.platform import Platform
from simulator.options import SimulateOptions
from simulator.pipeline import simulate
from stone_client.files.bags import bags_among
from stone_files.bag_files import BadBagFilesError
from testing.api.serving import Person, person, serving
from testing.worlds.recording_parts import RecordingPart, split_into
from tests.stone_client.test_server_commands import ingesting, refused, stone

pytestmark = pytest.mark.whole

TINY = SimulateOptions(seconds=1.0, channels=16, columns=120, cameras=False)
CUT_NS = 1_749_718_801_000_000_000


@pytest.fixture(autouse=True)
def _silence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("STONE_CONFIG_HOME", str(tmp_path / "configuration"))
    with capture_logs():
        yield


@pytest.fixture
def as_owner(platform: Platform, monkeypatch: pytest.MonkeyPatch) -> Iterator[Person]:
    owner = person(platform, "curator", "ada")
    with serving(platform) as address:
        monkeypatch.setenv("STONE_URL", address)
        monkeypatch.setenv("STONE_TOKEN", owner.secret)
        yield owner


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
        ("run", ["run_0.mcap", "run_1.mcap"]),
        ("cams.mcap", ["cams.mcap"]),
        ("ins_0.db3", ["ins_0.db3"]),
        ("radar.bag", ["radar.bag"]),
        ("split", ["split"]),
    ]
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
    with pytest.raises(BadBagFilesError, match=r"two of the recordings are called RUN\.mcap|called run\.mcap"):
        bags_among((tmp_path / "lidar" / "run.mcap", tmp_path / "cameras" / "RUN.mcap"))


def test_several_recordings_of_a_run_go_to_one_sequence_and_are_processed_together(
    platform: Platform, as_owner: Person, files: tuple[Path, ...]
) -> None:
    calibration = files[0].with_name("whole.calibration.yaml")
    with ingesting(platform):
        sent = stone("upload", *files, "--calibration", calibration)
        again = stone("upload", *files, "--calibration", calibration, "--json")
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
    assert refused(stone("process", "run", "--recording", "radar.mcap")) == "not_found"
    assert refused(stone("process", "run", "--clock-offset", "radar.mcap=0.1")) == "bad_clock_offset"
    asked = stone("process", "run", "--clock-offset", "ins.mcap=-0.08", "--json")
    assert asked.exit_code == 0, asked.stderr
    with platform.database.reading() as session:
        run = session.get_one(Job, json.loads(asked.stdout)["id"])
    assert run.arguments["recording_ids"] == [row.id for row in rows]
    assert run.arguments["clock_offsets_ns"] == {"ins.mcap": -80_000_000}


def test_a_run_of_named_recordings_is_of_these_alone(
    platform: Platform, as_owner: Person, files: tuple[Path, ...]
) -> None:
    with ingesting(platform):
        sent = stone("upload", *files, "--calibration", files[0].with_name("whole.calibration.yaml"))
    assert sent.exit_code == 0, sent.stderr
    asked = stone("process", "run", "--recording", "ins.mcap", "--json")
    assert asked.exit_code == 0, asked.stderr
    with platform.database.reading() as session:
        run = session.get_one(Job, json.loads(asked.stdout)["id"])
    assert (len(run.arguments["recording_ids"]), run.arguments["names_recordings"]) == (1, True)
