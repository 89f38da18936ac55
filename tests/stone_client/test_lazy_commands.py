"""Commands are loaded when they are looked at, and the list of them says what each says itself."""

import sys
from pathlib import Path

import pytest
from typer.main import get_command

from stone_client.lazy_commands import CommandPlace, LazyCommands, places
from stone_client.main import COMMANDS, PANELS, StoneGroup, app


@pytest.mark.parametrize("place", COMMANDS, ids=lambda place: place.word)
def test_the_list_says_what_the_command_says_itself(place: CommandPlace) -> None:
    outline, command = place.outline(), place.load()
    assert (outline.name, outline.help, outline.rich_help_panel) == (
        command.name,
        command.help,
        command.rich_help_panel,
    )
    assert outline.help


def test_every_command_stands_once_below_a_panel_that_help_knows() -> None:
    words = [place.word for place in COMMANDS]
    assert len(words) == len(set(words)) > 30
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


@pytest.mark.parametrize("body", ["", "dig = 1", "dig = made()", "dig = made(help=text)"])
def test_a_command_without_words_of_its_own_is_a_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, body: str
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "lazy_mute.py").write_text(body)
    with pytest.raises(LookupError):
        CommandPlace("dig", "Garden", "lazy_mute", "dig").help()
    with pytest.raises(LookupError):
        CommandPlace("dig", "Garden", "lazy_absent", "dig").help()


def test_a_place_is_named_after_its_module() -> None:
    assert places("Garden", "stone_local.commands", "label_sets") == (
        CommandPlace("label-sets", "Garden", "stone_local.commands.label_sets", "label_sets"),
    )


def test_the_app_is_a_group_of_them() -> None:
    group = get_command(app)
    assert isinstance(group, StoneGroup)
    assert list(group.commands) == [place.word for place in COMMANDS]
