"""The platform from Python: the same submissions as by command, refusals as errors with their codes."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from stone_client.errors import ServerRefusedError
from stone_client.sdk import Stone
from stone_client.server.submission import SubmissionInvalidError
from stone_submissions.manifest import read_manifest
from testing.refusals import refused_as
from testing.worlds.benchmark_world import predicted, submission_zip
from tests.api.inputs_made import made_input
from tests.stone_client.participating import Served, answered, scoring, zipped


@pytest.fixture
def stone(served: Served) -> Iterator[Stone]:
    with Stone(served.url, served.captain.secret) as made:
        yield made


def said(served: Served, part: str = "val", **more: str) -> dict[str, str]:
    entry = {"benchmark": served.world.benchmark, "phase": part, "team": served.team}
    return {**entry, "method": "GroundNet", "modality": "L", **more}


@pytest.mark.whole
def test_a_submission_waits_and_tells_its_scores(
    served: Served, stone: Stone, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = zipped(served, tmp_path / "sub.zip")
    with scoring(served.platform):
        submission = stone.submit(path, **said(served)).wait()
    assert (submission.state, repr(submission)) == ("scored", f"<Submission {submission.id} GroundNet scored>")
    assert set(submission.scores) == {"miou", "iou_occ", "iou_t", "iou_p", "iou_n"}
    parts = submission.breakdown("sequence")
    assert len(parts) == 2
    assert parts.rows()[0].keys() == {"name", "frames", *submission.scores}
    assert "<td>" in parts._repr_html_()
    assert stone.submit(str(path), **said(served)).id == submission.id, "the same file is the same submission"
    monkeypatch.setenv("STONE_URL", served.url)
    monkeypatch.setenv("STONE_TOKEN", served.captain.secret)
    assert answered("benchmark", "results", submission.id) == submission.results.record
    assert [one.id for one in stone.submissions()] == [stone.submission("latest").id] == [submission.id]
    with Stone() as by_login:
        assert by_login.submission(submission.id).scores == submission.scores
        board = by_login.leaderboard(served.world.benchmark, "val")
        assert board.record == answered("benchmark", "leaderboard", served.world.benchmark, "val")
        assert (board.rows[0].rank, board.rows[0].method) == (1, "GroundNet")
        assert board.rows.rows()[0]["miou"] == submission.scores["miou"]
        assert by_login.compare(submission.id, "latest")["miou"].difference == 0
    submission.withdraw("a mistake")
    assert len(stone.leaderboard(served.world.benchmark, "val").rows) == 0


def test_what_is_invalid_is_raised_with_the_whole_report(served: Served, stone: Stone, tmp_path: Path) -> None:
    frames = predicted(served.world.truth("val"), 0.1)
    path = submission_zip(tmp_path / "sub.zip", dict(list(frames.items())[:1]))
    with scoring(served.platform), pytest.raises(SubmissionInvalidError, match="1 problems") as caught:
        stone.submit(path, **said(served, kind="validation")).wait()
    assert caught.value.code == "missing_frame"
    assert caught.value.report["errors_total"] == 1


def test_refusals_are_errors_with_the_servers_codes(
    served: Served, stone: Stone, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = zipped(served, tmp_path / "sub.zip")
    with refused_as("unknown_team"):
        stone.submit(path, **said(served, team="nobody's"))
    with pytest.raises(ServerRefusedError, match="no phase") as caught:
        stone.submit(path, **said(served, phase="nothing"))
    assert caught.value.code == "not_found"
    monkeypatch.delenv("STONE_URL")
    with refused_as("no_server"):
        Stone()


def test_what_is_to_be_predicted_comes_with_its_frames(served: Served, stone: Stone, tmp_path: Path) -> None:
    made = made_input(served.platform, served.world.test, "drive", {"samples/LIDAR_TOP/a.pcd.bin": b"points"})
    told: list[str] = []
    with Stone(served.url, served.captain.secret, lambda stage, done, total: told.append(stage)) as heard:
        (tar,) = heard.inputs(served.world.benchmark, "test", tmp_path / "inputs")
    assert (tar.name, tar.stat().st_size) == ("drive.tar", made.tar[0])
    assert set(told) == {"drive.tar"}
    manifest = stone.manifest(served.world.benchmark, "test", tmp_path / "deep" / "M.json")
    assert set(read_manifest(manifest).tokens) == set(served.world.truth("test"))
