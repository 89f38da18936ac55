"""Commands that are imported when they are called; their help is read from the source without an import.

**Conventions.** The docstring of a command's function is its help. It is found by parsing the module, not by importing
it, so that `stone --help` does not load the dependencies of all commands.
"""

import ast
from collections.abc import Iterator, MutableMapping, Sequence
from copy import copy
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from inspect import cleandoc
from pathlib import Path
from typing import Any, ClassVar

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_group

from stone_client.stone_command import StoneCommand, in_words

Command = Any  # click's type, which typer contains under a private name


@dataclass(frozen=True)
class CommandPlace:
    """A command of `stone`: its word, its panel of the help, and the module and name of its function."""

    word: str
    panel: str
    module: str
    name: str

    def load(self) -> Command:
        """Return the command; this imports its module."""
        app = typer.Typer()
        app.callback()(_nothing)
        function = getattr(import_module(self.module), self.name)
        named: dict[str, Any] = {"help": running_text(function.__doc__ or ""), "rich_help_panel": self.panel or None}
        app.command(self.word, cls=StoneCommand, **named)(function)
        return get_group(app).commands[self.word]

    def outline(self) -> Command:
        """Return the entry of the command list: word, panel and help."""
        return TyperCommand(name=self.word, help=self.help(), rich_help_panel=self.panel or None)

    def help(self) -> str:
        """Return the function's docstring as running text. Raises LookupError."""
        spec = find_spec(self.module)
        if spec is None or spec.origin is None:
            raise LookupError(self.module)
        for node in ast.parse(Path(spec.origin).read_bytes()).body:
            if isinstance(node, ast.FunctionDef) and node.name == self.name:
                return running_text(ast.get_docstring(node) or "")
        raise LookupError(f"{self.module}.{self.name}")


@dataclass(frozen=True)
class GroupPlace:
    """A group of commands below one noun: its word, panel and help, and the places of its commands."""

    word: str
    panel: str
    text: str
    places: "Sequence[CommandPlace | GroupPlace]"

    def load(self) -> Command:
        """Return the group; its commands are imported one by one when they are called."""
        named: dict[str, Any] = {"name": self.word, "help": self.text, "rich_help_panel": self.panel or None}
        group = LazyGroup(no_args_is_help=True, **named)
        group.commands = LazyCommands(self.places, {})
        return group

    def outline(self) -> Command:
        """Return the entry of the command list: word, panel and help."""
        return TyperCommand(name=self.word, help=self.text, rich_help_panel=self.panel or None)


Place = CommandPlace | GroupPlace


def places(panel: str, package: str, *modules: str) -> tuple[CommandPlace, ...]:
    """Return commands of one panel, each in a module of its own name: `benchmark.submit` is the command `submit`."""
    return tuple(
        CommandPlace(name.replace("_", "-"), panel, f"{package}.{module}", name)
        for module, name in ((module, module.rpartition(".")[2]) for module in modules)
    )


class LazyGroup(TyperGroup):
    """A group of the commands at `places`, and of its registered commands."""

    places: ClassVar[Sequence[Place]] = ()

    def __init__(self, *, commands: Any = None, **attributes: Any) -> None:
        super().__init__(commands={}, **attributes)
        self.commands: MutableMapping[str, Command] = LazyCommands(self.places, commands or {})

    def get_params(self, ctx: Any) -> list[Any]:
        return in_words(super().get_params(ctx))

    def shell_complete(self, ctx: Any, incomplete: str) -> list[Any]:
        """Complete the words of commands from their outlines, without an import."""
        outlined = copy(self)
        outlined.commands = self.commands.outlines() if isinstance(self.commands, LazyCommands) else self.commands
        ctx.command = outlined
        return super(LazyGroup, outlined).shell_complete(ctx, incomplete)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        outlined = copy(self)
        outlined.commands = self.commands.outlines() if isinstance(self.commands, LazyCommands) else self.commands
        super(LazyGroup, outlined).format_help(ctx, formatter)


class LazyCommands(MutableMapping[str, Command]):
    """Commands by word, in the order of their places; each is loaded at its first use."""

    def __init__(self, listed: Sequence[Place], given: MutableMapping[str, Command]) -> None:
        self._places = {entry.word: entry for entry in listed}
        self._loaded = dict(given)

    def __getitem__(self, word: str) -> Command:
        if word not in self._loaded:
            self._loaded[word] = self._places[word].load()
        return self._loaded[word]

    def __setitem__(self, word: str, command: Command) -> None:
        self._loaded[word] = command

    def __delitem__(self, word: str) -> None:
        self._places.pop(word, None)
        del self._loaded[word]

    def __iter__(self) -> Iterator[str]:
        yield from self._places
        yield from (word for word in self._loaded if word not in self._places)

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __contains__(self, word: object) -> bool:
        return word in self._places or word in self._loaded

    def outlines(self) -> dict[str, Command]:
        """Return the help entry of each command; none is loaded."""
        return {word: self._loaded[word] if word in self._loaded else self._places[word].outline() for word in self}


def running_text(docstring: str) -> str:
    """Return a docstring with one line per paragraph, so that only the terminal breaks lines."""
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in cleandoc(docstring).split("\n\n"))


def _nothing() -> None:
    """Make a group of an app with one command."""
