"""`stone explain` says what a code means, without a server and without the platform."""

import json
from pathlib import Path

from typer.testing import CliRunner, Result

from stone_base.codes.catalogue import CATALOGUE
from stone_client.main import app
from tests.stone_client.test_platform_part import alone
from tests.stone_client.test_platform_part import stone as client

__all__ = ["alone"]


def stone(*arguments: str) -> Result:
    return CliRunner().invoke(app, list(arguments))


def test_a_code_is_explained_in_whatever_letters_it_is_typed() -> None:
    one = CATALOGUE["LAB-603"]
    for typed in ("LAB-603", "lab-603"):
        result = stone("explain", typed)
        assert result.exit_code == 0
        for words in ("LAB-603: labels may be wrong", one.meaning, one.remedy):
            assert words in result.stdout
    assert "no attempt is left" in stone("explain", "worker_lost").stdout


def test_a_code_that_harms_otherwise_as_an_error_says_so() -> None:
    assert "As an error: no labels." in stone("explain", "CAL-401").stdout
    assert "As a" not in stone("explain", "LAB-603").stdout


def test_all_codes_are_listed_for_people_and_programs() -> None:
    assert len(stone("explain").stdout.splitlines()) == len(CATALOGUE)
    listed = json.loads(stone("explain", "--json").stdout)["codes"]
    assert [one["code"] for one in listed] == list(CATALOGUE)
    assert json.loads(stone("explain", "TIM-201", "--json").stdout)["harm"] == "none"


def test_an_unknown_code_is_refused() -> None:
    result = stone("explain", "XYZ-999")
    assert result.exit_code == 1
    assert result.stderr.startswith("unknown_code: 'XYZ-999'")


def test_the_client_alone_explains(alone: Path) -> None:
    said = client(alone, "explain", "TIM-201")
    assert said.returncode == 0, said.stderr
    assert said.stdout.startswith("TIM-201: labels unaffected")
