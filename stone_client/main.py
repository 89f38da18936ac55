"""The `stone` command.

**Conventions.** A command's module names its options and imports its pipeline inside the function, so that
`stone --help` stays quick (numba, pyarrow and Open3D take seconds to load). Tables and JSON go to stdout, everything
else to stderr. The commands that need the platform are in `stone_local` and appear where that is installed. Exit codes
(design §7): 0 done, 1 the input is refused, 2 usage; 130 and 143 interrupted.
"""

from collections.abc import Callable
from typing import Annotated

import typer

from stone_client.commands.benchmark.benchmarks import benchmarks
from stone_client.commands.benchmark.compare import compare
from stone_client.commands.benchmark.inputs import inputs
from stone_client.commands.benchmark.leaderboard import leaderboard
from stone_client.commands.benchmark.manifest import manifest
from stone_client.commands.benchmark.reported import reported
from stone_client.commands.benchmark.results import results
from stone_client.commands.benchmark.submit import submit
from stone_client.commands.benchmark.teams import teams
from stone_client.commands.benchmark.validate import validate
from stone_client.commands.benchmark.withdraw import withdraw
from stone_client.commands.dataset.datasets import datasets
from stone_client.commands.dataset.splits import splits
from stone_client.commands.dataset.statistics import statistics
from stone_client.commands.explain import explain
from stone_client.commands.server.dataset_import import import_dataset
from stone_client.commands.server.download import download
from stone_client.commands.server.exports import exports
from stone_client.commands.server.login import login
from stone_client.commands.server.notifications import notifications
from stone_client.commands.server.process import process
from stone_client.commands.server.status import status
from stone_client.commands.server.upload import upload
from stone_client.commands.server.watch import watch
from stone_client.platform_part import add_refusals, platform_commands
from stone_client.refusals import RefusingGroup

app = typer.Typer(
    name="stone",
    cls=RefusingGroup,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
OWN_COMMANDS: dict[str, tuple[Callable[..., None], ...]] = {
    "On this machine": (validate, explain),
    "With a server": (login, upload, import_dataset, process, watch, status, exports, download),
    "The dataset": (statistics, splits, datasets),
    "Models": (),
    "A benchmark": (benchmarks, manifest, inputs, submit, results, leaderboard, compare, withdraw, reported),
}
OWN_GROUPS: dict[str, tuple[str, typer.Typer]] = {
    "teams": ("A benchmark", teams),
    "notifications": ("With a server", notifications),
}
PLATFORM_COMMANDS, PLATFORM_GROUPS = platform_commands()
COMMANDS = {panel: (*PLATFORM_COMMANDS.get(panel, ()), *own) for panel, own in OWN_COMMANDS.items()}
GROUPS = {**PLATFORM_GROUPS, **OWN_GROUPS}


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


for panel, commands in COMMANDS.items():
    for command in commands:
        app.command(rich_help_panel=panel)(command)
for name, (panel, group) in GROUPS.items():
    app.add_typer(group, name=name, rich_help_panel=panel)
if not PLATFORM_COMMANDS:
    add_refusals(app)


def main() -> None:
    app()


if __name__ == "__main__":
    main()
