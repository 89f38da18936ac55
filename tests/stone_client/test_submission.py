"""`stone benchmark submit` against the real API: sent, scored, printed; it resumes after an interruption."""

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import select
from typer.testing import Result

from services.runtime.orm import SubmissionRow, Upload
from stone_client.api import Api
from stone_client.files import tus
from stone_client.server import submission as submitting
from testing.api.serving import person
from testing.worlds.benchmark_world import predicted, submission_zip
from tests.stone_client.participating import (
    Served,
    answered,
    refused,
    scoring,
    stone,
    zipped,
)


def options(served: Served, part: str = "val") -> tuple[str, ...]:
    return (*served.at(part), "--team", served.team, "--method", "GroundNet", "--modality", "L")


def sent(served: Served, path: Path, *more: str, part: str = "val") -> Result:
    with scoring(served.platform):
        return stone("benchmark", "submit", path, *options(served, part), *more)


def test_predictions_are_scored_and_the_table_is_printed(served: Served, tmp_path: Path) -> None:
    (tmp_path / "page.txt").write_text("One sweep.\nNo training.\n")
    result = sent(served, zipped(served, tmp_path / "sub.zip"), "--description", str(tmp_path / "page.txt"))
    assert result.exit_code == 0, (result.stderr, result.exception)
    for word in ("GroundNet (L)", "mIoU", "IoU occ", "95 % here", "dangerous", "over-cautious"):
        assert word in result.stdout
    assert f"Next: stone benchmark leaderboard {served.world.benchmark} val" in result.stderr
    for step in ("Compute the checksum", "Upload", "queued"):
        assert step in result.stderr
    with served.platform.database.reading() as session:
        row = session.scalars(select(SubmissionRow).where(SubmissionRow.team_id == served.team_id)).one()
    assert (row.state, row.description, row.kind) == ("scored", "One sweep.\nNo training.\n", "entry")


def test_under_json_the_result_is_the_servers_own_and_1_for_the_truth_itself(served: Served, tmp_path: Path) -> None:
    path = submission_zip(tmp_path / "sub.zip", served.world.truth("val"))
    record = json.loads(sent(served, path, "--json").stdout)
    assert record["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert record["results"] == answered("benchmark", "results", record["id"])
    assert set(record["results"]["total"].values()) == {1.0}


def test_an_invalid_file_ends_with_1_and_the_servers_codes(served: Served, tmp_path: Path) -> None:
    frames = predicted(served.world.truth("val"), 0.1)
    frames.pop(next(iter(frames)))
    path = submission_zip(tmp_path / "sub.zip", frames)
    result = sent(served, path)
    assert refused(result) == "missing_frame"
    assert stone("validate", path, *served.at("val")).stderr.splitlines()[-1] == result.stderr.splitlines()[-1]
    again = sent(served, path, "--json")
    report = json.loads(again.stdout)
    assert (again.exit_code, report["errors_total"], report["errors"][0]["code"]) == (1, 1, "missing_frame")
    assert served.count(SubmissionRow) == 1, "what stands answers; nothing is sent twice"


def test_a_file_that_is_only_checked_costs_nothing(served: Served, tmp_path: Path) -> None:
    path = zipped(served, tmp_path / "sub.zip", "test")
    result = sent(served, path, "--validate-only", part="test")
    assert (result.exit_code, result.stdout) == (0, "valid\n")
    with served.platform.database.reading() as session:
        kind = select(SubmissionRow.kind).where(SubmissionRow.team_id == served.team_id)
        assert session.scalars(kind).one() == "validation"
    entered = answered("benchmark", "submit", path, *options(served, "test"), "--no-wait")
    assert (entered["kind"], served.count(SubmissionRow)) == ("entry", 2), "the same file is an entry besides"


class PowerCutError(Exception):
    """The client is gone."""


def cut(*_arguments: Any, **_named: Any) -> Any:
    raise PowerCutError


CUTS = {
    "before the first byte": (submitting, "upload_file"),
    "between pieces": (tus, "send_rest"),
    "before it is finalised": (submitting, "Purpose"),
}


@pytest.mark.parametrize("moment", CUTS)
def test_interrupted_and_run_again_it_goes_on_with_the_same_draft(
    served: Served, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    path = zipped(served, tmp_path / "sub.zip")
    with monkeypatch.context() as patched:
        patched.setattr(*CUTS[moment], cut)
        assert isinstance(stone("benchmark", "submit", path, *options(served)).exception, PowerCutError)
    assert stone("benchmark", "submit", path, *options(served), "--no-wait").exit_code == 0
    assert (served.count(SubmissionRow), served.count(Upload)) == (1, 1)


def test_bytes_that_arrived_are_not_sent_again(served: Served, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = zipped(served, tmp_path / "sub.zip")
    piece_bytes = path.stat().st_size // 3
    monkeypatch.setattr(tus, "PIECE_BYTES", piece_bytes)
    pieces: list[int] = []
    send_piece = tus._send_piece

    def counted(api: Api, address: str, piece: bytes, offset: int) -> int:
        if len(pieces) == 1:
            pieces.append(0)
            raise PowerCutError
        pieces.append(len(piece))
        return send_piece(api, address, piece, offset)

    monkeypatch.setattr(tus, "_send_piece", counted)
    assert isinstance(stone("benchmark", "submit", path, *options(served)).exception, PowerCutError)
    assert stone("benchmark", "submit", path, *options(served), "--no-wait").exit_code == 0
    assert sum(pieces) == path.stat().st_size


@pytest.mark.whole
def test_interrupted_while_it_waits_nothing_is_scored_twice(served: Served, tmp_path: Path) -> None:
    path = zipped(served, tmp_path / "sub.zip")
    first = stone("benchmark", "submit", path, *options(served), "--no-wait").stdout.split()[1]
    for _ in range(2):  # while it is queued, and when it has been scored
        assert json.loads(sent(served, path, "--json").stdout)["id"] == first
    assert served.count(SubmissionRow) == 1
    assert stone("benchmark", "submit", path, *options(served), "--again", "--no-wait").stdout.split()[1] != first


def test_another_name_is_another_entry_and_a_new_page_is_not(served: Served, tmp_path: Path) -> None:
    path = zipped(served, tmp_path / "sub.zip")
    first = answered("benchmark", "submit", path, *options(served), "--no-wait")["id"]
    (tmp_path / "page.txt").write_text("Now with a page.")
    told = answered("benchmark", "submit", path, *options(served), "--no-wait", "--description", tmp_path / "page.txt")
    assert (told["id"], told["description"]) == (first, "Now with a page.")
    renamed = (*options(served)[:-3], "OtherNet", *options(served)[-2:])
    assert answered("benchmark", "submit", path, *renamed, "--no-wait")["id"] != first


@pytest.mark.whole
def test_a_team_mate_goes_on_where_the_captain_left(
    served: Served, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = zipped(served, tmp_path / "sub.zip")
    first = stone("benchmark", "submit", path, *options(served), "--no-wait").stdout.split()[1]
    secret = answered("team", "invite", served.team)["secret"]
    monkeypatch.setenv("STONE_TOKEN", person(served.platform, "participant").secret)
    assert stone("team", "join", secret).exit_code == 0
    assert json.loads(sent(served, path, "--json").stdout)["id"] == first


def test_what_is_not_there_or_not_yours_is_refused_before_a_byte_is_sent(served: Served, tmp_path: Path) -> None:
    path = zipped(served, tmp_path / "sub.zip")
    method = ("--method", "GroundNet", "--modality", "L")
    other = stone("benchmark", "submit", path, *served.at("val"), "--team", served.world.teams[0], *method)
    assert refused(other) == "unknown_team"
    assert f"yours are {served.team}" in other.stderr
    nowhere = ("--benchmark", "nothing", "--phase", "val", "--team", served.team)
    assert refused(stone("benchmark", "submit", path, *nowhere, *method)) == "not_found"
    assert served.count(SubmissionRow) == 0


def test_what_cannot_be_said_is_a_usage_error(served: Served, tmp_path: Path) -> None:
    path = zipped(served, tmp_path / "sub.zip")
    assert stone("benchmark", "submit", path, *options(served)[:-1], "X").exit_code == 2
    assert stone("benchmark", "submit", path, *options(served), "--validate-only", "--baseline").exit_code == 2
    (tmp_path / "page.txt").write_bytes(b"\xff\xfe")
    assert stone("benchmark", "submit", path, *options(served), "--description", tmp_path / "page.txt").exit_code == 2
    (tmp_path / "page.txt").write_text("a" * 20_001)
    assert stone("benchmark", "submit", path, *options(served), "--description", tmp_path / "page.txt").exit_code == 2
    assert stone("benchmark", "submit", tmp_path / "none.zip", *options(served)).exit_code == 2
