"""Commands of `stone` with readable options: old names are accepted, types and errors are words.

**Conventions.** Typer shows Python's types and pydantic's messages; the classes here replace both, for every command
alike. Typer creates the parameters, so their class is set afterwards.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args

import typer
from typer.core import TyperArgument, TyperCommand, TyperOption

from stone_client.old_words import with_new_options

WORDS = {int: "NUMBER", float: "NUMBER", Path: "PATH"}


class WordyOption(TyperOption):
    """An option whose type, default and errors are words."""

    def display_type(self, ctx: Any) -> str:
        return "" if self.is_flag else type_word(self)

    def _get_default_string(self, *, show_default_is_str: bool, **named: Any) -> str:
        if show_default_is_str:
            return str(self.show_default)
        return super()._get_default_string(show_default_is_str=False, **named)

    def _get_number_range_help_str(self) -> str | None:
        return range_words(self.min, self.max)

    def process_value(self, ctx: Any, value: Any) -> Any:
        if value is None and not (self.required or self.multiple):  # avoids pydantic, which is slow to load
            return None if self.callback is None else self.callback(ctx, self, value)
        try:
            return super().process_value(ctx, value)
        except typer.BadParameter as error:
            raise worded(error, self) from None


class WordyArgument(TyperArgument):
    """An argument whose errors are words; its name stands for its type."""

    def display_type(self, ctx: Any) -> str:
        return ""

    def _usage_display_name(self) -> str:
        name = self.display_name_raw.strip("[]").removesuffix("...") + ("..." if self.nargs != 1 else "")
        return name if self.required else f"[{name}]"

    def process_value(self, ctx: Any, value: Any) -> Any:
        try:
            return super().process_value(ctx, value)
        except typer.BadParameter as error:
            raise worded(error, self) from None


def in_words(params: Sequence[Any]) -> list[Any]:
    """Return the parameters of a command, each with its class of this module."""
    for param in params:
        param.__class__ = WordyArgument if isinstance(param, TyperArgument) else WordyOption
    return list(params)


class StoneCommand(TyperCommand):
    """A command that accepts the old names of its options too."""

    def get_params(self, ctx: Any) -> list[Any]:
        return in_words(super().get_params(ctx))

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except typer.BadParameter as error:
            if isinstance(error.param_hint, str):  # quoted as Typer's own
                error.param_hint = repr(error.param_hint.strip("'"))
            raise

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        known = {option for param in self.params for option in (*param.opts, *param.secondary_opts)}
        return super().parse_args(ctx, with_new_options(args, known))


def type_word(param: Any) -> str:
    """Return the word for the values of a parameter: its choices, NUMBER, PATH or TEXT."""
    described = param.type_descriptor
    if described.is_choice:
        return "|".join(choice_words(described))
    inner = get_args(described.annotation) if described.is_list else (described.annotation,)
    return WORDS.get(inner[0], "TEXT")


def choice_words(described: Any) -> list[str]:
    return [str(getattr(choice, "value", choice)) for choice in described.choices]


def range_words(least: float | None, most: float | None) -> str | None:
    """Return a range of numbers for the help; None without a range."""
    if least is None and most is None:
        return None
    if most is None:
        return f"at least {_number(least)}"
    return f"at most {_number(most)}" if least is None else f"{_number(least)} to {_number(most)}"


def worded(error: typer.BadParameter, param: Any) -> typer.BadParameter:
    """Return the error with our sentence instead of pydantic's: the given value, and the expected one."""
    faults: list[Any] = getattr(error.__cause__, "errors", list)()
    if not faults:
        return error
    described, given = param.type_descriptor, repr(str(faults[0]["input"])[:80])
    if described.is_choice:
        error.message = f"{given} is not one of {', '.join(choice_words(described))}"
    elif type_word(param) == "NUMBER":
        kind = "a whole number" if int in (described.annotation, *get_args(described.annotation)) else "a number"
        error.message = f"{given} is not {kind}{_between(param.min, param.max)}"
    else:
        error.message = error.message.removeprefix("Value error, ")
    return error


def _number(value: float | None) -> str:
    return str(int(value) if value is not None and value == int(value) else value)


def _between(least: float | None, most: float | None) -> str:
    span = range_words(least, most)
    return f" from {span}" if span and least is not None and most is not None else f" of {span}" if span else ""
