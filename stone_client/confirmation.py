"""Confirmation of permanent acts: a question on a terminal, a refusal without `--yes` elsewhere, `--dry-run`.

**Conventions.** The question and its answer use stderr and stdin, so stdout contains only the result. A refusal without
a terminal is wrong usage (exit code 2); a declined question is exit code 1. In both cases the client sends no request
that changes anything.
"""

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import typer

from stone_base.errors import StoneError, one_line
from stone_client.server.ids import place_from_newest
from stone_client.streams import echo_json

YesOption = Annotated[bool, typer.Option("--yes", help="Confirm the act; required without a terminal.")]
DryRunOption = Annotated[bool, typer.Option("--dry-run", help="Print the effect, and change nothing.")]


class NotConfirmedError(StoneError):
    """An act that cannot be undone lacks its confirmation; the command's exit code is 2."""

    code = "not_confirmed"


@dataclass(frozen=True)
class PermanentAct:
    """An act that cannot be undone: an imperative clause that names its object, and a sentence about its effect."""

    clause: str
    effect: str

    def __str__(self) -> str:
        return f"{self.clause}: {self.effect}"


def require_confirmation(act: PermanentAct, *, is_given: bool, named: str = "") -> None:
    """Return if `--yes` was given, or the user confirms `act` on the terminal.

    `named` is the user's word for the object. `latest` can soon mean another object, so it requires `--yes` instead of
    a question. Raises `not_confirmed`; `typer.Exit` after a declined question.
    """
    if is_given:
        return
    if place_from_newest(named) is not None:
        raise NotConfirmedError(f"{act}; {named!r} may soon mean a newer submission: give its id, or add --yes")
    if not is_at_terminal():
        raise NotConfirmedError(f"{act}; add --yes to confirm, or --dry-run to see the effect")
    typer.echo(one_line(f"{act.clause[:1].upper()}{act.clause[1:]}: {act.effect}."), err=True)
    typer.echo("Continue? [y/N] ", err=True, nl=False)
    if sys.stdin.readline().strip().lower() not in ("y", "yes"):  # typer.confirm writes a space on stdout
        typer.echo("Nothing was changed.", err=True)
        raise typer.Exit(1)


def confirm(
    act: PermanentAct,
    details: Mapping[str, Any],
    *,
    is_given: bool,
    is_dry_run: bool,
    as_json: bool,
    named: str = "",
) -> None:
    """Return if `act` is confirmed; after a dry run end the command."""
    if is_dry_run:
        show_dry_run(act, details, as_json=as_json)
        raise typer.Exit
    require_confirmation(act, is_given=is_given, named=named)


def show_dry_run(act: PermanentAct, details: Mapping[str, Any], *, as_json: bool) -> None:
    """Print the act that a dry run skipped, with `details` under `--json`."""
    if as_json:
        echo_json({"dry_run": True, "act": act.clause, "effect": act.effect, **details})
    else:
        typer.echo(one_line(f"dry run: would {act}"))


def is_at_terminal() -> bool:
    """Return whether a person can read a question and answer it."""
    return sys.stdin.isatty() and sys.stderr.isatty()
