"""The `stone` command.

**Conventions.** A command's module is imported when the command is asked for (`stone_client/lazy_commands.py`), and
imports its pipeline inside its function, so that `stone --help` and a slip of the pen are answered at once (numba,
pyarrow and Open3D take seconds to load). Tables and JSON go to stdout, everything else to stderr. The commands that
need the platform are in `stone_local` and appear where that is installed. Exit codes (design §7): 0 done, 1 the input
is refused, 2 usage; 130 and 143 interrupted.
"""

import os
from typing import Annotated

import typer

from stone_base.process_tuning import tune_command
from stone_client.lazy_commands import CommandPlace, LazyGroup, places
from stone_client.platform_part import add_refusals, platform_commands
from stone_client.refusals import RefusingGroup

PACKAGE = "stone_client.commands"
PANELS = ("On this machine", "With a server", "The dataset", "Models", "A benchmark")
IMPORT = CommandPlace("import", "With a server", f"{PACKAGE}.server.dataset_import", "import_dataset")
OWN_COMMANDS = (
    *places("On this machine", PACKAGE, "benchmark.validate", "baseline", "explain"),
    *places("With a server", PACKAGE, "server.login", "server.upload", "server.register"),
    IMPORT,
    *places("With a server", PACKAGE, "server.process", "server.watch", "server.status", "server.exports"),
    *places("With a server", PACKAGE, "server.download"),
    *places("The dataset", PACKAGE, "dataset.statistics", "dataset.splits", "dataset.datasets"),
    *places("A benchmark", PACKAGE, "benchmark.benchmarks", "benchmark.manifest", "benchmark.inputs"),
    *places("A benchmark", PACKAGE, "benchmark.submit", "benchmark.results", "benchmark.leaderboard"),
    *places("A benchmark", PACKAGE, "benchmark.compare", "benchmark.withdraw", "benchmark.reported"),
    *places("A benchmark", PACKAGE, "benchmark.teams"),
    *places("With a server", PACKAGE, "server.notifications"),
)
PLATFORM_COMMANDS, PLATFORM_GROUPS = platform_commands()
COMMANDS = tuple(
    place for panel in PANELS for place in (*PLATFORM_COMMANDS, *OWN_COMMANDS, *PLATFORM_GROUPS) if place.panel == panel
)


class StoneGroup(RefusingGroup, LazyGroup):
    """The commands of `stone`, by panel as help shows them."""

    places = COMMANDS


app = typer.Typer(
    name="stone",
    cls=StoneGroup,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


def _say_version(is_asked: bool) -> None:
    if is_asked:
        from stone_client.release import own_release

        typer.echo(f"stone {own_release()}")
        raise typer.Exit


@app.callback()
def stone(
    _version: Annotated[
        bool, typer.Option("--version", callback=_say_version, is_eager=True, help="Print the release.")
    ] = False,
) -> None:
    """Surround-view 3D traversability labels from a field robot's own recordings."""


if not PLATFORM_COMMANDS:
    add_refusals(app)


def main() -> None:
    tune_command()
    # Linear algebra here is of small matrices: its threads would be made while numpy loads, and spin, for nothing.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    app()


if __name__ == "__main__":
    main()
