"""The `stone` command.

**Conventions.** A command's module is imported when the command is called (`stone_client/lazy_commands.py`), and
imports its pipeline inside its function. So `stone --help` and wrong usage are answered at once (numba, pyarrow and
Open3D take seconds to load). Tables and JSON go to stdout, everything else to stderr. The commands that require the
platform are in `stone_local` and appear if it is installed. Exit codes (design §7): 0 success, 1 refused input, 2
usage; 130 and 143 interrupted.
"""

import os
from difflib import get_close_matches
from typing import Annotated, Any

import typer

from stone_base.process_tuning import tune_command
from stone_client.command_tree import COMMANDS
from stone_client.lazy_commands import LazyGroup
from stone_client.old_words import words_like, words_of_today
from stone_client.platform_part import add_refusals, is_platform_installed
from stone_client.refusals import RefusingGroup
from stone_client.streams import choose_output, echo_notice

EVERYWHERE = ("--quiet", "--no-progress")


class StoneGroup(RefusingGroup, LazyGroup):
    """The commands of `stone` by help panel, and the words of the previous release."""

    places = COMMANDS

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        words, change = words_of_today(args)
        if change and not ctx.resilient_parsing:
            echo_notice(change)
        is_like_none = words[0] not in self.commands and not get_close_matches(words[0], list(self.commands))
        if is_like_none and (near := words_like(words[0])):
            ctx.fail(f"No such command {words[0]!r}. Did you mean {', '.join(map(repr, near))}?")
        return super().resolve_command(ctx, words)

    def parse_args(self, ctx: Any, args: list[str]) -> Any:
        """Accept the options of every command after the command's word too, except after `--`."""
        end = args.index("--") if "--" in args else len(args)
        words = args[:end]
        first = [word for word in EVERYWHERE if word in words]
        return super().parse_args(ctx, [*first, *(word for word in words if word not in first), *args[end:]])


app = typer.Typer(
    name="stone",
    cls=StoneGroup,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    add_completion=True,
    pretty_exceptions_enable=False,
)


def _print_version(is_given: bool) -> None:
    if is_given:
        from platform import machine, python_version, system

        from stone_client.release import own_release

        typer.echo(f"stone {own_release()} (Python {python_version()}, {system()} {machine()})")
        raise typer.Exit


@app.callback()
def stone(
    _version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the release.")
    ] = False,
    is_quiet: Annotated[
        bool, typer.Option("--quiet", envvar="STONE_QUIET", help="Print only results, warnings and errors.")
    ] = False,
    is_without_progress: Annotated[
        bool, typer.Option("--no-progress", envvar="STONE_NO_PROGRESS", help="Print no progress.")
    ] = False,
) -> None:
    """Surround-view 3D traversability labels from a field robot's own recordings."""
    choose_output(is_quiet=is_quiet, has_progress=not is_without_progress)


if not is_platform_installed():
    add_refusals(app)


def main() -> None:
    tune_command()
    # The matrices are small: OpenBLAS threads would start while numpy loads, and only spin.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    app()


if __name__ == "__main__":
    main()
