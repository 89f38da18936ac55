"""Rules for every command of the tree: `--json`, `-h`, help in words, and completion that imports nothing."""

import os
import subprocess
import sys
from typing import Any

import pytest
from typer.main import get_command

from stone_client.command_tree import COMMANDS, leaves
from stone_client.lazy_commands import CommandPlace, GroupPlace, Place
from stone_client.main import app
from tests.stone_client.participating import stone

LEAVES = list(leaves())
GROUPS = {"auth", "sequence", "label-set", "dataset", "dataset splits", "benchmark", "team", "calibration", "model"}


def options_of(place: CommandPlace) -> set[str]:
    return {option for param in place.load().params for option in param.opts}


def test_there_is_a_tree() -> None:
    words = {words for words, _ in LEAVES}
    assert len(words) == len(LEAVES) > 50
    assert {one.rpartition(" ")[0] for one in words} >= GROUPS


@pytest.mark.parametrize(("words", "place"), LEAVES, ids=[words for words, _ in LEAVES])
def test_every_command_prints_one_json_object_if_it_is_told_to(words: str, place: CommandPlace) -> None:
    assert "--json" in options_of(place)


@pytest.mark.parametrize(("words", "place"), LEAVES, ids=[words for words, _ in LEAVES])
def test_every_command_calls_its_output_alike(words: str, place: CommandPlace) -> None:
    assert not options_of(place) & {"--out", "--no-wait", "--output-dir"}
    assert ("-o" in options_of(place)) == ("--output" in options_of(place))


@pytest.mark.parametrize("words", ["", *sorted(GROUPS), *(words for words, _ in LEAVES)])
def test_help_is_words_and_not_the_types_of_a_language(words: str) -> None:
    short, long = stone(*words.split(), "-h"), stone(*words.split(), "--help")
    assert (short.exit_code, short.stdout) == (0, long.stdout)
    for type_name in ("<bool>", "<str>", "<int", "<float", "<list", "<path>", "<file>", "<directory>", "<=x"):
        assert type_name not in short.stdout
    assert "(cores)" not in short.stdout
    assert "{" not in short.stdout.split("\n\n")[0]


def descriptions(places: tuple[Place, ...]) -> list[Any]:
    """The outlines of all commands and groups."""
    inner = [one for place in places if isinstance(place, GroupPlace) for one in descriptions(tuple(place.places))]
    return [*(place.outline() for place in places), *inner]


def test_the_terminal_alone_breaks_the_lines_of_help() -> None:
    for outline in descriptions(COMMANDS):
        assert all("\n" not in paragraph for paragraph in outline.help.split("\n\n")), outline.name


COMPLETED = """
import sys
from stone_client.main import app
try: app(prog_name="stone")
finally: print(*sys.modules, file=sys.stderr)
"""


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
@pytest.mark.parametrize(
    ("typed", "offered", "loaded"),
    [
        ("stone se", {"sequence", "serve"}, set()),
        ("stone sequence ", {"list", "upload"}, set()),
        ("stone upload --cal", {"--calibration"}, {"stone_client.commands.sequence.upload"}),
        ("stone simulate x.mcap --illumination d", {"day", "dawn", "dusk"}, {"stone_local.commands.simulate"}),
        ("stone label --profile ", {"field", "local", "paper"}, {"stone_local.commands.label"}),
    ],
)
def test_a_shell_completes_words_without_the_modules_of_commands(
    shell: str, typed: str, offered: set[str], loaded: set[str]
) -> None:
    """Catches alone that completion imports kernels, or every command: only a fresh process shows its modules."""
    words = typed.split(" ")
    asked = {"_STONE_COMPLETE": f"complete_{shell}", "_TYPER_COMPLETE_ARGS": typed, "COMP_WORDS": typed}
    asked |= {"COMP_CWORD": str(len(words) - 1), "_TYPER_COMPLETE_FISH_ACTION": "get-args"}
    outcome = subprocess.run(
        [sys.executable, "-c", COMPLETED], env={**os.environ, **asked}, capture_output=True, text=True, check=True
    )
    printed = outcome.stdout.replace('"', " ").replace(":", " ").split()
    assert offered <= set(printed), outcome.stdout
    modules = outcome.stderr.split()
    assert {place.module for _, place in LEAVES} & set(modules) == loaded
    heavy = {"numba", "scipy", "open3d", "httpx", "services", *([] if loaded else ["numpy", "pydantic"])}
    assert not {name.partition(".")[0] for name in modules} & heavy


def test_completion_is_installed_and_shown_by_options_of_the_root() -> None:
    options = {option for param in get_command(app).params for option in param.opts}
    assert options >= {"--install-completion", "--show-completion"}
