"""The `stone` command.

**Conventions.** A command's module names its options and imports its pipeline inside the function, so that
`stone --help` stays quick (numba, pyarrow and Open3D take seconds to load). Tables and JSON go to stdout, everything
else to stderr. Exit codes (design §7): 0 done, 1 the input is refused, 2 usage; 130 and 143 interrupted.
"""

from collections.abc import Callable

import typer

from client.commands.baseline import baseline
from client.commands.benchmarks import benchmarks
from client.commands.compare import compare
from client.commands.datasets import datasets
from client.commands.demo import demo
from client.commands.download import download
from client.commands.export import export
from client.commands.exports import exports
from client.commands.inputs import inputs
from client.commands.inspect import inspect
from client.commands.label import label
from client.commands.leaderboard import leaderboard
from client.commands.login import login
from client.commands.manifest import manifest
from client.commands.process import process
from client.commands.recover import recover
from client.commands.results import results
from client.commands.score import score
from client.commands.serve import serve
from client.commands.simulate import simulate
from client.commands.splits import splits
from client.commands.statistics import statistics
from client.commands.status import status
from client.commands.submit import submit
from client.commands.teams import teams
from client.commands.upload import upload
from client.commands.validate import validate
from client.commands.watch import watch
from client.commands.withdraw import withdraw
from client.refusals import RefusingGroup

app = typer.Typer(
    name="stone",
    help="Surround-view 3D traversability labels from a field robot's own recordings.",
    cls=RefusingGroup,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
COMMANDS: dict[str, tuple[Callable[..., None], ...]] = {
    "On this machine": (simulate, inspect, recover, label, export, baseline, validate, score, demo),
    "With a server": (serve, login, upload, process, watch, status, exports, download),
    "The dataset": (statistics, splits, datasets),
    "A benchmark": (benchmarks, manifest, inputs, submit, results, leaderboard, compare, withdraw),
}
for panel, commands in COMMANDS.items():
    for command in commands:
        app.command(rich_help_panel=panel)(command)
app.add_typer(teams, name="teams", rich_help_panel="A benchmark")


def main() -> None:
    app()


if __name__ == "__main__":
    main()
