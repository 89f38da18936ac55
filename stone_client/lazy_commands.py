"""Commands that are imported when they are asked for: the help of all of them is read from their source alone.

**Conventions.** A command's function says in its docstring what it does, a group's `typer.Typer` in its `help`; both
are found by parsing the module, not by importing it, so that `stone --help` does not load what all commands stand on.
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

Command = Any  # click's, which typer carries along under a private name


@dataclass(frozen=True)
class CommandPlace:
    """A command of `stone`: its word, its panel of the help, and where its function, or its group, is."""

    word: str
    panel: str
    module: str
    name: str

    def load(self) -> Command:
        """The command, its module imported."""
        found = getattr(import_module(self.module), self.name)
        app = typer.Typer()
        app.callback()(_nothing)
        if isinstance(found, typer.Typer):
            app.add_typer(found, name=self.word, rich_help_panel=self.panel)
        else:
            app.command(self.word, rich_help_panel=self.panel)(found)
        return get_group(app).commands[self.word]

    def outline(self) -> Command:
        """What the list of commands says of it: word, panel and help."""
        return TyperCommand(name=self.word, help=self.help(), rich_help_panel=self.panel)

    def help(self) -> str:
        """Of the function's docstring, or the keyword `help` of the group. Raises LookupError."""
        spec = find_spec(self.module)
        if spec is None or spec.origin is None:
            raise LookupError(self.module)
        for node in ast.parse(Path(spec.origin).read_bytes()).body:
            if isinstance(node, ast.FunctionDef) and node.name == self.name:
                return ast.get_docstring(node) or ""
            if isinstance(node, ast.Assign) and _is_name(node.targets[0], self.name):
                return _help_of(node.value)
        raise LookupError(f"{self.module}.{self.name}")


def places(panel: str, package: str, *modules: str) -> tuple[CommandPlace, ...]:
    """Commands of one panel, each in a module of its own name: `benchmark.submit` is the command `submit`."""
    return tuple(
        CommandPlace(name.replace("_", "-"), panel, f"{package}.{module}", name)
        for module, name in ((module, module.rpartition(".")[2]) for module in modules)
    )


class LazyGroup(TyperGroup):
    """A group of the commands at `places`, and of those that it is given."""

    places: ClassVar[Sequence[CommandPlace]] = ()

    def __init__(self, *, commands: Any = None, **attributes: Any) -> None:
        super().__init__(commands={}, **attributes)
        self.commands: MutableMapping[str, Command] = LazyCommands(self.places, commands or {})

    def format_help(self, ctx: Any, formatter: Any) -> None:
        outlined = copy(self)
        outlined.commands = self.commands.outlines() if isinstance(self.commands, LazyCommands) else self.commands
        super(LazyGroup, outlined).format_help(ctx, formatter)


class LazyCommands(MutableMapping[str, Command]):
    """Commands by word, in the order of their places; each is loaded once it is looked at."""

    def __init__(self, found: Sequence[CommandPlace], given: MutableMapping[str, Command]) -> None:
        self._places = {place.word: place for place in found}
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
        """What help says of each, none of them loaded."""
        return {word: self._loaded[word] if word in self._loaded else self._places[word].outline() for word in self}


def _nothing() -> None:
    """The callback that makes a group of an app with one command."""


def _is_name(node: ast.expr, name: str) -> bool:
    return isinstance(node, ast.Name) and node.id == name


def _help_of(node: ast.expr) -> str:
    """The keyword `help` of the call, a literal. Raises LookupError."""
    said = [keyword.value for keyword in node.keywords if keyword.arg == "help"] if isinstance(node, ast.Call) else []
    if not said or not isinstance(said[0], ast.Constant):
        raise LookupError("a group without a help of its own")
    return cleandoc(str(said[0].value))
