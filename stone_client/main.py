"""The `stone` command.

**Conventions.** A command's module names its options and imports its pipeline inside the function, so that
`stone --help` stays quick (numba, pyarrow and Open3D take seconds to load). Tables and JSON go to stdout, everything
else to stderr. Exit codes (design §7): 0 done, 1 the input is refused, 2 usage; 130 and 143 interrupted.
"""

from collections.abc import Callable

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
from stone_client.commands.benchmark.withdraw import withdraw
from stone_client.commands.dataset.datasets import datasets
from stone_client.commands.dataset.splits import splits
from stone_client.commands.dataset.statistics import statistics
from stone_client.commands.local.baseline import baseline
from stone_client.commands.local.calibration import calibration
from stone_client.commands.local.check import check
from stone_client.commands.local.demo import demo
from stone_client.commands.local.export import export
from stone_client.commands.local.inspect import inspect
from stone_client.commands.local.label import label
from stone_client.commands.local.recover import recover
from stone_client.commands.local.score import score
from stone_client.commands.local.simulate import simulate
from stone_client.commands.local.validate import validate
from stone_client.commands.models.onnx import onnx
from stone_client.commands.models.predict import predict
from stone_client.commands.models.train import train
from stone_client.commands.server.download import download
from stone_client.commands.server.exports import exports
from stone_client.commands.server.login import login
from stone_client.commands.server.process import process
from stone_client.commands.server.serve import serve
from stone_client.commands.server.status import status
from stone_client.commands.server.upload import upload
from stone_client.commands.server.watch import watch
from stone_client.refusals import RefusingGroup

app = typer.Typer(
    name="stone",
    help="Surround-view 3D traversability labels from a field robot's own recordings.",
    cls=RefusingGroup,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
COMMANDS: dict[str, tuple[Callable[..., None], ...]] = {
    "On this machine": (simulate, inspect, recover, label, export, baseline, validate, score, check, demo),
    "With a server": (serve, login, upload, process, watch, status, exports, download),
    "The dataset": (statistics, splits, datasets),
    "Models": (train, predict, onnx),
    "A benchmark": (benchmarks, manifest, inputs, submit, results, leaderboard, compare, withdraw, reported),
}
for panel, commands in COMMANDS.items():
    for command in commands:
        app.command(rich_help_panel=panel)(command)
GROUPS: dict[str, tuple[str, typer.Typer]] = {
    "calibration": ("On this machine", calibration),
    "teams": ("A benchmark", teams),
}
for name, (panel, group) in GROUPS.items():
    app.add_typer(group, name=name, rich_help_panel=panel)


def main() -> None:
    app()


if __name__ == "__main__":
    main()
