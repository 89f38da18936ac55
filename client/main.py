"""The `stone` command.

**Conventions.** A command's module names its options and imports its pipeline inside the function, so that
`stone --help` stays quick (numba, pyarrow and Open3D take seconds to load). Tables and JSON go to stdout, everything
else to stderr. Exit codes (design §7): 0 done, 1 the input is refused, 2 usage; 130 and 143 interrupted.
"""

import typer

from client.commands.demo import demo
from client.commands.inspect import inspect
from client.commands.label import label
from client.commands.score import score
from client.commands.serve import serve
from client.commands.simulate import simulate
from client.commands.validate import validate
from client.refusals import RefusingGroup

app = typer.Typer(
    name="stone",
    help="Surround-view 3D traversability labels from a field robot's own recordings.",
    cls=RefusingGroup,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
for command in (simulate, inspect, label, validate, score, demo, serve):
    app.command()(command)


def main() -> None:
    app()


if __name__ == "__main__":
    main()
