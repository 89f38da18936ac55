"""`stone inspect --html` writes a page beside its answer, whole or not at all, and the same one every time."""

import json
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from stone_client.main import app
from tests.stone_recordings.report.quality import recordings
from tests.stone_recordings.report.quality.recordings import ticks
from tests.stone_recordings.rigs import written


def inspect(path: Path, *options: str) -> Result:
    return CliRunner().invoke(app, ["inspect", str(path), *options])


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "$HOME <b>.mcap"
    return written(path, recordings.clouds(ticks(2, 10)), recordings.solutions(ticks(2, 20), 56))


def test_the_page_holds_the_score_and_the_pictures_and_json_the_numbers(recording: Path, tmp_path: Path) -> None:
    result = inspect(recording, "--html", str(tmp_path / "out.html"), "--json")
    assert result.exit_code == 0, result.output
    quality = json.loads(result.stdout)["quality"]
    page = (tmp_path / "out.html").read_text("utf-8")
    assert f"Quality {quality['score']} of 100" in page
    assert page.count('<img src="data:image/png;base64,') == 2
    assert "$HOME &lt;b&gt;.mcap" in page
    assert [path.name for path in tmp_path.iterdir()] == ["out.html"]


def test_people_read_the_score_and_what_it_lost(recording: Path, tmp_path: Path) -> None:
    result = inspect(recording, "--html", str(tmp_path / "out.html"))
    assert re.search(r"quality \d+ of 100", result.stdout)
    assert re.search(r"TIM-201 +-\d", result.stdout)


def test_a_topic_that_lies_is_an_error_once_it_is_looked_at(tmp_path: Path) -> None:
    lies = [recordings.picture("/camera/front/image", int(stamp), b"no picture") for stamp in ticks(1, 10)]
    path = written(tmp_path / "run.mcap", lies, recordings.clouds(ticks(1, 10)))
    assert inspect(path).exit_code == 0
    result = inspect(path, "--html", str(tmp_path / "out.html"))
    assert result.exit_code == 1
    assert "/camera/front/image: 10 of 10 sampled messages are left out" in result.stderr
    assert (tmp_path / "out.html").is_file()


def test_the_same_recording_gives_the_same_bytes(recording: Path, tmp_path: Path) -> None:
    for name in ("a.html", "b.html"):
        assert inspect(recording, "--html", str(tmp_path / name)).exit_code == 0
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()


def test_without_the_option_nothing_is_measured(recording: Path) -> None:
    assert "quality" not in json.loads(inspect(recording, "--json").stdout)


def test_what_is_no_recording_leaves_no_page(tmp_path: Path) -> None:
    (tmp_path / "run.mcap").write_bytes(b"no recording")
    result = inspect(tmp_path / "run.mcap", "--html", str(tmp_path / "out.html"))
    assert result.exit_code == 1
    assert not (tmp_path / "out.html").exists()
