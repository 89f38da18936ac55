"""A rosbag2 folder arrives as one recording: every file of it, each only once, then sealed together.

Catches alone a folder of which a file is missing, or sent twice, after an interruption.
"""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from sqlalchemy import func, select
from structlog.testing import capture_logs

from services.ingest.stages import handlers
from services.runtime.jobs.execution import run_next
from services.runtime.orm import QuotaEntry, Recording, Upload
from services.runtime.platform import Platform
from simulator.options import SimulateOptions
from simulator.pipeline import simulate
from stone_client.api import Api
from stone_client.credentials import Server
from stone_client.errors import ServerRefusedError
from stone_client.files.bags import LocalBag, called, hashed_bag
from stone_client.server.sequences import add_recording, ensure_sequence, has_other_recording
from stone_files.bag_files import BadBagFilesError
from stone_files.bag_fingerprint import recording_sha256
from testing.api.serving import Person, person, serving
from tests.stone_client.test_server_commands import ingesting, refused, stone
from tests.stone_recordings.splitting import split_into

pytestmark = pytest.mark.whole

TINY = SimulateOptions(seconds=1.0, channels=16, columns=120, cameras=False)


def quiet(stage: str, done: int, total: int) -> None:
    """Tests watch nothing."""


@pytest.fixture(autouse=True)
def _silence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The server's log lines stay out of the command's stdout, and nobody's logins are read."""
    monkeypatch.setenv("STONE_CONFIG_HOME", str(tmp_path / "configuration"))
    with capture_logs():
        yield


@pytest.fixture
def owner(platform: Platform) -> Person:
    return person(platform, "curator", "ada")


@pytest.fixture
def url(platform: Platform) -> Iterator[str]:
    with serving(platform) as address:
        yield address


@pytest.fixture(scope="module")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Path:
    simulate(tmp_path_factory.mktemp("tiny") / "run.mcap", TINY)
    return tmp_path_factory.getbasetemp() / "tiny0" / "run.calibration.yaml"


@pytest.fixture
def folder(calibration: Path, tmp_path: Path) -> Path:
    """Three files of one bag, and a file that is no part of it."""
    folder = tmp_path / "run.2026"
    folder.mkdir()
    split_into(calibration.with_name("run.mcap"), folder, 3)
    (folder / "notes.txt").write_text("mud on the front camera")
    return folder


def uploads(platform: Platform) -> list[tuple[str, str]]:
    with platform.database.reading() as session:
        return sorted((row.filename, row.state) for row in session.scalars(select(Upload)))


def test_a_folder_is_one_recording_of_its_files(
    platform: Platform, url: str, owner: Person, folder: Path, calibration: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STONE_URL", url)
    monkeypatch.setenv("STONE_TOKEN", owner.secret)
    with ingesting(platform):
        sent = stone("upload", folder, "--calibration", calibration, "--name", "forest", "--json")
        again = stone("upload", folder, "--calibration", calibration, "--name", "forest", "--json")
    assert (sent.exit_code, again.exit_code) == (0, 0), sent.stderr + again.stderr
    assert json.loads(sent.stdout)["recording"] == json.loads(again.stdout)["recording"]
    assert uploads(platform) == [(f"run_{number}.mcap", "consumed") for number in range(3)]
    with platform.database.reading() as session:
        recording = session.scalars(select(Recording)).one()
        taken_bytes = session.scalar(select(func.sum(QuotaEntry.amount)))
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
    url: str, owner: Person, calibration: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STONE_URL", url)
    monkeypatch.setenv("STONE_TOKEN", owner.secret)
    (tmp_path / "empty").mkdir()
    with pytest.raises(BadBagFilesError, match="holds no file of a bag"):
        hashed_bag(tmp_path / "empty", quiet)
    assert refused(stone("upload", tmp_path / "empty", "--calibration", calibration)) == "bad_recording_files"
    for name in ("a.mcap", "b.db3"):
        (tmp_path / "empty" / name).write_text(name)
    assert refused(stone("upload", tmp_path / "empty", "--calibration", calibration)) == "bad_recording_files"


def test_a_bag_is_called_after_its_folder_or_its_one_file(folder: Path, tmp_path: Path) -> None:
    assert (hashed_bag(folder, quiet).name, called(folder)) == ("run.2026", "run.2026")
    (tmp_path / "alone").mkdir()
    (tmp_path / "alone" / "run_0.mcap").write_text("x")
    assert (hashed_bag(tmp_path / "alone", quiet).name, called(tmp_path / "alone")) == ("run_0.mcap", "alone")
    assert called(tmp_path / "alone" / "run_0.mcap") == "run_0"


def test_a_group_that_names_a_stranger_fails_whole(platform: Platform, url: str, owner: Person, folder: Path) -> None:
    bag = hashed_bag(folder, quiet)
    with Api(Server(url, owner.secret)) as api:
        sequence = ensure_sequence(api, "forest")
        odd = LocalBag("../run", bag.files)
        with pytest.raises(ServerRefusedError, match="folders"):
            add_recording(api, sequence, odd, quiet)
    assert {state for _name, state in uploads(platform)} == {"complete"}
    assert not run_next(platform, "ingest", handlers(platform))
