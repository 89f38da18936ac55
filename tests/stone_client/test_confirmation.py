"""Acts that cannot be undone need `--yes` or an answer on a terminal, and `--dry-run` changes nothing."""

import json
import os
import pty
import re
import subprocess
import sys
from pathlib import Path

import pytest

from services.runtime.platform import Platform
from stone_client import confirmation
from testing.api.serving import Person, person
from testing.worlds.published import published_sequence
from tests.stone_client.participating import Served, answered, scoring, stone, zipped

DOCS = Path(__file__).resolve().parents[2] / "docs"
ASKING = """
from stone_client.confirmation import PermanentAct, require_confirmation
require_confirmation(PermanentAct("drain the lake", "the fish die"), is_given=False)
print("drained")
"""


@pytest.fixture
def submission(served: Served, tmp_path: Path) -> str:
    path = zipped(served, tmp_path / "sub.zip")
    with scoring(served.platform):
        sent = answered(
            "benchmark",
            "submit",
            path,
            *served.at("val"),
            "--team",
            served.team,
            "--method",
            "Sweep",
            "--modality",
            "L",
        )
    return str(sent["id"])


def is_withdrawn(submission: str) -> bool:
    (one,) = answered("benchmark", "results")["submissions"]
    assert one["id"] == submission
    return one["withdrawn_at"] is not None


def test_withdraw_needs_yes_without_a_terminal(submission: str) -> None:
    for named in (submission, "latest"):
        result = stone("benchmark", "withdraw", named, stdin="y\n")
        assert result.exit_code == 2
        assert result.stderr.startswith("not_confirmed: withdraw submission")
        assert submission in result.stderr
        assert "--yes" in result.stderr
    shown = answered("benchmark", "withdraw", submission, "--dry-run")
    assert (shown["dry_run"], shown["id"]) == (True, submission)
    assert not is_withdrawn(submission)
    assert stone("benchmark", "withdraw", submission, "--yes").exit_code == 0
    assert is_withdrawn(submission)


def test_withdraw_reads_the_answer_on_a_terminal(submission: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(confirmation, "is_at_terminal", lambda: True)
    assert stone("benchmark", "withdraw", submission, stdin="n\n").exit_code == 1
    assert stone("benchmark", "withdraw", submission, stdin="").exit_code == 1, "an end of input is no consent"
    moving = stone("benchmark", "withdraw", "latest", stdin="y\n")
    assert (moving.exit_code, submission in moving.stderr) == (2, True)
    assert not is_withdrawn(submission)
    accepted = stone("benchmark", "withdraw", submission, stdin="y\n")
    assert accepted.exit_code == 0
    assert "permanently" in accepted.stderr
    assert is_withdrawn(submission)


@pytest.fixture
def names(platform: Platform, url: str, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Three sequences on a platform whose administrator gives the commands."""
    monkeypatch.setenv("STONE_URL", url)
    monkeypatch.setenv("STONE_TOKEN", person(platform, "administrator").secret)
    owner: Person = person(platform, "curator")
    for region in "ABC":
        published_sequence(platform, owner.user_id, environment="lake", illumination="day", region=region)
    return sorted(one["name"] for one in answered("dataset", "splits", "show")["unassigned"])


def test_splits_are_saved_and_published_only_with_consent(tmp_path: Path, names: list[str]) -> None:
    path = tmp_path / "splits.json"
    path.write_text(json.dumps({"train": names[:1], "val": names[1:2], "test": names[2:]}))
    shown = answered("dataset", "splits", "put", path, "--dry-run")
    assert shown["can_be_put"]
    assert [(one["sequence"], one["from"], one["to"]) for one in shown["changes"]] == [
        (names[0], None, "train"),
        (names[1], None, "val"),
        (names[2], None, "test"),
    ]
    assert stone("dataset", "splits", "put", path).exit_code == 2
    assert answered("dataset", "splits", "show")["sizes"] == {"train": 0, "val": 0, "test": 0}
    assert stone("dataset", "splits", "put", path, "--yes").exit_code == 0
    assert answered("dataset", "splits", "put", path, "--dry-run")["changes"] == []
    plan = answered("dataset", "publish", "stone-1.0", "--dry-run")
    frames = {
        entry["name"]: entry["frames"]
        for part in ("train", "val", "test")
        for entry in answered("dataset", "splits", "show")[part]
    }
    assert plan["parts"] == {
        part: {"sequences": [name], "frames": frames[name]}
        for part, name in zip(("train", "val", "test"), names, strict=True)
    }
    refused = stone("dataset", "publish", "stone-1.0")
    assert refused.exit_code == 2
    assert "stone-1.0" in refused.stderr
    assert answered("dataset", "list")["datasets"] == []
    assert stone("dataset", "publish", "stone-1.0", "--yes").exit_code == 0


def test_a_draft_that_changes_during_the_question_is_not_published(
    tmp_path: Path, names: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "splits.json"

    def put(**parts: list[str]) -> None:
        path.write_text(json.dumps(parts))
        assert stone("dataset", "splits", "put", path, "--yes").exit_code == 0

    def answer_after_another_put() -> bool:
        put(train=names[1:2], val=names[:1], test=names[2:])
        return True

    put(train=names[:1], val=names[1:2], test=names[2:])
    monkeypatch.setattr(confirmation, "is_at_terminal", answer_after_another_put)
    result = stone("dataset", "publish", "stone-1.0", stdin="y\n")
    assert (result.exit_code, "precondition_failed" in result.stderr) == (1, True)
    assert answered("dataset", "list")["datasets"] == []


def test_a_dry_run_of_splits_that_break_a_rule_is_a_refusal(tmp_path: Path, names: list[str]) -> None:
    path = tmp_path / "splits.json"
    path.write_text(json.dumps({"train": names[:1], "val": names[:1], "test": []}))
    shown = stone("dataset", "splits", "put", path, "--dry-run")
    assert shown.exit_code == 1
    assert "whole_sequences" in shown.stderr


@pytest.mark.parametrize(("typed", "code"), [(b"y\n", 0), (b"n\n", 1)])
def test_the_question_is_put_on_a_real_terminal(typed: bytes, code: int) -> None:
    ours, theirs = pty.openpty()
    with subprocess.Popen(
        [sys.executable, "-c", ASKING], stdin=theirs, stderr=theirs, stdout=subprocess.PIPE, close_fds=True
    ) as asking:
        os.close(theirs)
        os.write(ours, typed)
        printed, _ = asking.communicate()
    os.close(ours)
    assert (asking.returncode == 0) == (code == 0)
    assert printed == (b"drained\n" if code == 0 else b"")


FENCED = re.compile(r"^```\w*\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def test_no_guide_confirms_an_act_after_a_line_that_may_be_refused() -> None:
    """A pasted block goes on after a refusal, so `--yes` is in its first line, or behind `&&`."""
    confirming = [
        (number, line)
        for page in sorted(DOCS.rglob("*.md"))
        for block in FENCED.findall(page.read_text("utf-8"))
        for number, line in enumerate(block.splitlines())
        if "--yes" in line
    ]
    assert confirming
    assert [line for number, line in confirming if number and "&&" not in line.partition("--yes")[0]] == []
