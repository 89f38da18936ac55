"""A refusal is one harmless line and exit code 1; a fault of the program keeps its traceback."""

import errno
import json

import pytest
import typer
from typer.testing import CliRunner, Result

from stone.errors import StoneError, one_line
from stone_client.refusals import RefusingGroup
from stone_client.streams import JsonOption


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
    ("number", "code"),
    [(errno.EACCES, "not_permitted"), (errno.EROFS, "not_permitted"), (errno.ENOSPC, "disk_full")],
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
