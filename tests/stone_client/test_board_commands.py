"""What participants look at by command: benchmarks, manifests, inputs, teams, results, boards, comparisons."""

import json
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
from structlog.testing import capture_logs

from stone_client.server.boards import board_table
from stone_client.tables import show
from stone_submissions.manifest import read_manifest
from testing.api.serving import person
from testing.worlds.benchmark_world import World
from tests.api.inputs_made import made_input
from tests.stone_client.participating import (
    Served,
    answered,
    joined,
    refused,
    scoring,
    stone,
    zipped,
)

SWEEPS = {"samples/LIDAR_TOP/a.pcd.bin": bytes(range(256)) * 900, "v1.0-trainval/sample.json": b"[\n]\n"}


@pytest.fixture(scope="module")
def entries(served_world: tuple[World, str], tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The ids of three scored submissions by method: two of one team to val, one to test."""
    folder, captain = tmp_path_factory.mktemp("sent"), joined(*served_world)
    made: dict[str, str] = {}
    with pytest.MonkeyPatch.context() as patched, capture_logs(), scoring(captain.platform):
        patched.setenv("STONE_URL", captain.url)
        patched.setenv("STONE_TOKEN", captain.captain.secret)
        for method, part, errors in (("Good", "val", 0.05), ("Bad", "val", 0.6), ("Hidden", "test", 0.1)):
            path = zipped(captain, folder / f"{method}.zip", part, errors)
            said = (*captain.at(part), "--team", captain.team, "--method", method, "--modality", "C+L")
            made[method] = answered("benchmark", "submit", path, *said)["id"]
    return made | {"team": captain.team, "secret": captain.captain.secret}


@pytest.fixture
def as_team(served: Served, entries: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    monkeypatch.setenv("STONE_TOKEN", entries["secret"])
    return entries


def test_benchmarks_are_listed_with_what_their_phases_allow(served: Served) -> None:
    shown = stone("benchmark", "list").stdout
    assert all(word in shown for word in (served.world.benchmark, "val", "test", "hidden", "open"))
    one = stone("benchmark", "list", served.world.benchmark).stdout
    assert "test: " in one, "what is shown to whom"
    (record,) = answered("benchmark", "list")["benchmarks"]
    assert {phase["name"] for phase in record["phases"]} == {"val", "test"}
    assert refused(stone("benchmark", "list", "nothing")) == "not_found"


def test_a_manifest_is_written_and_names_the_frames(served: Served, tmp_path: Path) -> None:
    record = answered("benchmark", "manifest", served.world.benchmark, "test", "-o", tmp_path / "M.json")
    assert set(read_manifest(tmp_path / "M.json").tokens) == set(served.world.truth("test"))
    assert record["sha256"] == sha256((tmp_path / "M.json").read_bytes()).hexdigest()
    assert (
        refused(stone("benchmark", "manifest", served.world.benchmark, "nothing", "-o", tmp_path / "no.json"))
        == "not_found"
    )
    assert not (tmp_path / "no.json").exists()


def test_validating_against_the_server_is_validating_against_its_manifest(served: Served, tmp_path: Path) -> None:
    stone("benchmark", "manifest", served.world.benchmark, "test", "-o", tmp_path / "M.json")
    for part, code in (("test", 0), ("val", 1)):
        path = zipped(served, tmp_path / f"{part}.zip", part)
        local, by_server = (
            stone("validate", path, *how, "--json")
            for how in (("--manifest", str(tmp_path / "M.json")), served.at("test"))
        )
        assert (local.exit_code, by_server.exit_code) == (code, code)
        assert local.stdout == by_server.stdout
    assert stone("validate", path).exit_code == 2
    assert stone("validate", path, "--benchmark", "b").exit_code == 2
    assert stone("validate", path, "--manifest", tmp_path / "M.json", *served.at("test")).exit_code == 2


def test_inputs_are_downloaded_once(served: Served, tmp_path: Path) -> None:
    assert answered("benchmark", "inputs", served.world.benchmark, "val", "-o", tmp_path / "none") == {"inputs": []}
    made = made_input(served.platform, served.world.test, "drive", SWEEPS)
    output = tmp_path / "inputs" / "drive.tar"
    (first,) = answered("benchmark", "inputs", served.world.benchmark, "test", "-o", output.parent)["inputs"]
    content = output.read_bytes()
    assert (len(content), sha256(content).hexdigest()) == made.tar
    assert (first["resumed_at_bytes"], first["output"]) == (0, str(output))
    (again,) = answered("benchmark", "inputs", served.world.benchmark, "test", "-o", output.parent)["inputs"]
    assert again["resumed_at_bytes"] == len(content), "nothing is fetched twice"


def test_a_team_is_founded_invited_into_and_joined(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    assert stone("team", "create", "Terrain Gang").stdout.startswith("created: Terrain Gang (participant-")
    assert refused(stone("team", "create", "terrain  gang")) == "name_taken"
    invited = stone("team", "invite", "terrain gang")
    assert "stone team join" in invited.stderr
    newcomer = person(served.platform, "participant", "grace")
    monkeypatch.setenv("STONE_TOKEN", newcomer.secret)
    assert stone("team", "join", invited.stdout.strip()).exit_code == 0
    (team,) = answered("team", "list")["teams"]
    assert team["name"] == "Terrain Gang"
    assert "grace" in team["members"]
    assert "Terrain Gang" in stone("team", "list").stdout
    assert refused(stone("team", "join", invited.stdout.strip())) != "internal_error", "it lets one in"
    assert refused(stone("team", "invite", "nobody's")) == "unknown_team"


def test_results_are_shown_whole_and_in_parts(as_team: dict[str, str]) -> None:
    shown = stone("benchmark", "results", as_team["Good"]).stdout
    assert all(word in shown for word in ("Good (C+L)", "mIoU", "IoU T", "95 % here", "ground truth in rows"))
    for by, name in (("sequence", "val-forest"), ("environment", "lake"), ("illumination", "night"), ("distance", "m")):
        result = stone("benchmark", "results", as_team["Good"], "--by", by)
        assert result.exit_code == 0, result.stderr
        assert name in result.stdout
    assert len(answered("benchmark", "results", as_team["Good"], "--by", "sequence")["parts"]) == 2


def test_submissions_are_listed_newest_first_and_named_by_how_late_they_are(as_team: dict[str, str]) -> None:
    listed = answered("benchmark", "results")["submissions"]
    assert [one["method"] for one in listed] == ["Hidden", "Bad", "Good"]
    assert "Hidden" in stone("benchmark", "results").stdout
    assert answered("benchmark", "results", "latest")["submission_id"] == as_team["Hidden"]
    assert answered("benchmark", "results", "latest~2")["submission_id"] == as_team["Good"]
    assert answered("benchmark", "results", as_team["Good"][-8:])["submission_id"] == as_team["Good"]
    assert refused(stone("benchmark", "results", as_team["Good"][:6])) == "ambiguous_id"
    same = stone("benchmark", "compare", "latest", as_team["Hidden"])
    assert (same.exit_code, "A and B are the same submission" in " ".join(same.stderr.split())) == (2, True)
    for named in ("latest~3", "nope"):
        result = stone("benchmark", "results", named)
        assert refused(result) == "no_submission"
        assert "your teams have 3" in result.stderr
    assert stone("benchmark", "results", "--by", "sequence").exit_code == 2


def test_what_is_no_submission_is_not_found(served: Served) -> None:
    assert refused(stone("benchmark", "results", "0" * 32)) == "not_found"
    assert refused(stone("benchmark", "results", "../phases")) == "no_submission"
    assert refused(stone("benchmark", "results", "latest")) == "no_submission"


def test_a_board_is_a_table_and_every_file_the_server_makes(
    served: Served, as_team: dict[str, str], tmp_path: Path
) -> None:
    at = (served.world.benchmark, "val")
    shown = stone("benchmark", "leaderboard", *at)
    assert all(word in shown.stdout for word in ("Good", "C+L", f"{as_team['team']} *", "mIoU", "danger"))
    assert "Bad" not in shown.stdout
    assert "Bad" in stone("benchmark", "leaderboard", *at, "--all").stdout
    rows = answered("benchmark", "leaderboard", *at)["rows"]
    assert rows[0]["submission_id"] == as_team["Good"]
    assert json.loads(stone("benchmark", "leaderboard", *at, "--format", "json").stdout)["rows"] == rows
    for form, sign in (("csv", "miou"), ("md", "| Good |"), ("tex", "\\begin{tabular}")):
        text = stone("benchmark", "leaderboard", *at, "--format", form).stdout
        assert "Good" in text, form
        assert sign in text, form
    parquet = tmp_path / "board.parquet"
    assert stone("benchmark", "leaderboard", *at, "--format", "parquet", "-o", parquet).exit_code == 0
    assert parquet.read_bytes()[:4] == b"PAR1"
    assert stone("benchmark", "leaderboard", *at, "--format", "parquet").exit_code == 2


def test_two_entries_are_compared_by_paired_draws(as_team: dict[str, str]) -> None:
    record = answered("benchmark", "compare", as_team["Good"], as_team["Bad"])
    assert record["ratios"]["miou"]["difference"] > 0
    shown = stone("benchmark", "compare", "latest~2", "latest~1").stdout
    assert all(word in shown for word in ("A − B", "mIoU", as_team["Good"], as_team["Bad"]))
    assert refused(stone("benchmark", "compare", as_team["Good"], as_team["Hidden"])) not in ("internal_error",)


def test_names_of_others_are_text_and_nothing_else(
    served: Served, as_team: dict[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    """What a server says is shown, not obeyed: neither markup nor escapes reach the terminal."""
    record: dict[str, Any] = answered("benchmark", "leaderboard", served.world.benchmark, "val")
    record["rows"][0] |= {"method": "[red]x[/red]\x1b[2J", "team": "[link=file:///]y"}
    show(board_table(record))
    printed = capsys.readouterr().out
    assert "[red]x[/red]" in printed
    assert "[link=file:///]y" in printed
    assert "\x1b" not in printed
