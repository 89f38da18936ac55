"""The lines of a first submission: every command and option exists; the starter code is what the docs print."""

import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import typer

from services.domain.benchmarks.starter import starter_code
from stone_client.main import app
from web.boards.submission_steps import StepsPlace, submission_steps

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("team", ["My team", "Terrain 'Gang' & Co", 'a "b" $HOME; rm'])
def test_every_line_is_a_command_with_options_that_exist(
    team: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for written in ("val.json", "run.zip"):  # by the steps before
        (tmp_path / written).touch()
    lines = [step.line for step in submission_steps(StepsPlace("https://stone.test", None, "stone", "val", team))]
    ours = [shlex.split(line) for line in lines if line.startswith("stone ")]
    assert len(ours) == 6
    assert [team in words for words in ours] == [False, True, False, False, False, True]
    for words in ours:
        parsed(typer.main.get_command(app), words[1:])


def parsed(command: Any, words: list[str]) -> None:
    """Parse the words as the command would, below its groups; nothing is run. Raises what the command's parser does."""
    while hasattr(command, "commands"):
        command, words = command.commands[words[0]], words[1:]
    command.make_context(command.name, list(words))


def test_a_wrong_option_is_noticed() -> None:
    with pytest.raises(Exception, match=r"(?i)no such option"):
        parsed(typer.main.get_command(app), ["submit", "--phaze", "val"])


def test_the_starter_code_is_what_the_docs_print() -> None:
    docs = (ROOT / "docs" / "participant.md").read_text("utf-8")
    block = re.search(r"```python\n(# predict\.py:.*?)```", docs, re.DOTALL)
    assert block is not None
    assert starter_code().decode() == block[1]
