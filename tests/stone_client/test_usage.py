"""The command line itself: usage, refusals, the list of commands, and how far something is."""

import errno
import json
import sys
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner, Result

from stone.errors import StoneError, one_line
from stone_client.command_tree import COMMANDS, PANELS, leaves
from stone_client.lazy_commands import CommandPlace, LazyCommands, Place
from stone_client.old_words import OLD_WORDS, OldWord, words_of_today
from stone_client.refusals import RefusingGroup
from stone_client.streams import JsonOption
from tests.stone_client.participating import stone


def test_wrong_usage_is_exit_code_2(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for arguments in [
        [],
        ["inspect"],
        ["inspect", "absent.mcap"],
        ["label", "absent.mcap", "--calibration", "absent.yaml", "-o", "out"],
        ["validate", "absent.zip", "--manifest", "absent.json"],
        ["score", "absent.zip", "--ground-truth", "absent"],
        ["simulate", "out.mcap", "--seconds", "0"],
        ["simulate", "out.mcap", "--seconds", "nan"],
        ["simulate", "out.mcap", "--channels", "100000"],
        ["simulate", "out.mcap", "--seed", "-1"],
        ["demo", "--workers", "0"],
        ["inspect", "absent.mcap", "--unknown"],
        ["upload", "absent.mcap", "--calibration", "absent.yaml"],
        ["process"],
        ["watch"],
        ["download", "run"],
        ["download", "run", "--format", "nuscenes", "-o", "folder"],
        ["download", "run", "--format", "obj", "-o", "run.tar"],
        ["exports"],
        ["exports", "run", "--format", "obj"],
        ["serve", "--port", "65536"],
        ["serve", "--workers", "0"],
    ]:
        monkeypatch.chdir(tmp_path)
        assert stone(*arguments).exit_code == 2
        assert list(tmp_path.iterdir()) == []


class MuddyError(StoneError):
    code = "muddy"


def run_raising(error: BaseException, *options: str) -> Result:
    app = typer.Typer(cls=RefusingGroup, pretty_exceptions_enable=False)

    @app.command()
    def drive(as_json: JsonOption = False) -> None:
        raise error

    @app.command()
    def park() -> None:
        raise error

    return CliRunner().invoke(app, ["drive", *options])


def test_a_stone_error_is_one_line_on_stderr_and_exit_code_1() -> None:
    result = run_raising(MuddyError("the ditch is 2 m deep; at most 0.3 m can be crossed"))
    assert result.exit_code == 1
    assert result.stderr == "muddy: the ditch is 2 m deep; at most 0.3 m can be crossed\n"
    assert result.stdout == ""


def test_under_json_the_same_refusal_is_an_object_on_stdout() -> None:
    result = run_raising(MuddyError("stuck"), "--json")
    assert result.exit_code == 1
    assert result.stderr == "muddy: stuck\n"
    expected = {"code": "muddy", "severity": "error", "topic": "", "message": "stuck"}
    assert json.loads(result.stdout) == {"findings": [expected]}


def test_a_hostile_name_cannot_write_on_the_terminal() -> None:
    result = run_raising(MuddyError("file '\x1b[2Jname\nmuddy: second line\u202e' is bad"))
    assert result.stderr == "muddy: file '\\x1b[2Jname\\nmuddy: second line\\u202e' is bad\n"


@pytest.mark.parametrize(
    ("number", "code"), [(errno.EACCES, "not_permitted"), (errno.EROFS, "not_permitted"), (errno.ENOSPC, "disk_full")]
)
def test_what_the_machine_refuses_is_one_line_too(number: int, code: str) -> None:
    result = run_raising(OSError(number, "says the kernel", "out/labels"))
    assert result.exit_code == 1
    assert result.stderr == f"{code}: out/labels: says the kernel\n"


@pytest.mark.parametrize("fault", [ValueError("a bug"), OSError(errno.ENOENT, "a file of ours is gone"), MemoryError()])
def test_a_fault_of_the_program_is_not_swallowed(fault: Exception) -> None:
    result = run_raising(fault)
    assert result.exception is fault
    assert result.stderr == ""


def test_ctrl_c_is_exit_code_130() -> None:
    assert run_raising(KeyboardInterrupt()).exit_code == 130


def test_plain_text_is_not_changed() -> None:
    assert one_line("δ = 0.2 m, „Grube“ 長い") == "δ = 0.2 m, „Grube“ 長い"


@pytest.mark.parametrize("place", [*COMMANDS, *(place for _, place in leaves())], ids=lambda place: place.word)
def test_the_list_says_what_the_command_says_itself(place: Place) -> None:
    outline, command = place.outline(), place.load()
    assert (outline.name, outline.help, outline.rich_help_panel) == (
        command.name,
        command.help,
        command.rich_help_panel,
    )
    assert outline.help


def test_every_command_stands_once_below_a_panel_that_help_knows() -> None:
    words = [place.word for place in COMMANDS]
    assert len(words) == len(set(words)) > 20
    assert {place.panel for place in COMMANDS} == set(PANELS)


def test_a_command_is_imported_when_it_is_looked_at(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "lazy_dig.py").write_text('def dig() -> None:\n    """Dig a hole."""\n')
    commands = LazyCommands([CommandPlace("dig", "Garden", "lazy_dig", "dig")], {})
    assert "dig" in commands
    assert list(commands) == ["dig"]
    assert commands.outlines()["dig"].help == "Dig a hole."
    assert "lazy_dig" not in sys.modules
    assert commands["dig"].name == "dig"
    assert "lazy_dig" in sys.modules
    assert commands["dig"] is commands["dig"]
    with pytest.raises(KeyError):
        commands["bury"]


def called(row: OldWord) -> list[str]:
    """The old command as it was typed, with an argument where the row needs one."""
    return [
        row.old,
        *(["THING"] if row.needs_argument else []),
        *([row.flag] if row.flag else []),
        *(["DIR"] if row.becomes else []),
    ]


@pytest.mark.parametrize("row", OLD_WORDS, ids=str)
def test_an_old_word_runs_the_new_command_and_names_it_in_one_line(row: OldWord) -> None:
    old, new = stone(*called(row), "--help"), stone(*row.new.split(), "--help")
    assert (old.exit_code, new.exit_code) == (0, 0), (old.stderr, new.stderr)
    assert old.stdout == new.stdout
    asked = f"stone {row.old} {row.flag}".rstrip()
    assert old.stderr == f"{asked} is now stone {row.new}\n"
    assert new.stderr == ""


def test_every_command_of_release_0_1_still_has_a_word() -> None:
    words = {
        "simulate", "inspect", "recover", "label", "export", "calibration", "label-sets", "baseline", "score",
        "ceiling", "check", "demo", "serve", "train", "predict", "onnx", "validate", "explain", "login", "upload",
        "register", "import", "process", "watch", "status", "exports", "download", "statistics", "splits", "datasets",
        "benchmarks", "manifest", "inputs", "submit", "results", "leaderboard", "compare", "withdraw", "reported",
        "teams", "notifications",
    }  # fmt: skip
    assert words <= {place.word for place in COMMANDS} | {row.old for row in OLD_WORDS}


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("datasets v1 --create --licence CC-BY", "dataset publish v1 --licence CC-BY"),
        ("datasets v1 --download data --inputs", "dataset download v1 --output data --inputs"),
        ("datasets v1 --download=data", "dataset download v1 --output data"),
        ("datasets --server http://host", "dataset list --server http://host"),
        ("datasets v1 --server http://host", "dataset show v1 --server http://host"),
        ("splits --propose 31,7,5 --leave-out a", "dataset splits propose 31,7,5 --leave-out a"),
        ("splits --put=splits.json", "dataset splits put splits.json"),
        ("status --server http://host --json", "sequence list --server http://host --json"),
        ("status --json demo", "sequence status --json demo"),
        ("team list", "team list"),
    ],
)
def test_the_flags_of_an_old_command_that_chose_an_act_are_verbs(old: str, new: str) -> None:
    assert " ".join(words_of_today(old.split())[0]) == new


def test_an_old_option_runs_as_the_new_one(tmp_path: Path) -> None:
    (tmp_path / "run.mcap").write_bytes(b"nothing")
    renamed = stone("recover", tmp_path / "run.mcap", "--out", tmp_path / "whole.mcap")
    assert renamed.stderr.splitlines()[0] == "--out is now --output"
    assert renamed.exit_code == 1, renamed.stderr
