"""`stone benchmark list`: the benchmarks and their phases, with their rules."""

from typing import Annotated, Any

import typer

from stone_base.errors import one_line
from stone_client.options import ServerOption
from stone_client.streams import JsonOption, echo_json
from stone_client.tables import show

BenchmarkArgument = Annotated[
    str | None, typer.Argument(metavar="[BENCHMARK]", help="A benchmark's name (default: all).")
]


def listed(benchmark: BenchmarkArgument = None, server: ServerOption = None, as_json: JsonOption = False) -> None:
    """List the benchmarks with their phases: dates, quotas, and the visibility of results."""
    from stone_client.connection import connected
    from stone_client.server.benchmarks import phases_table, read_benchmark, read_benchmarks

    with connected(server) as api:
        benchmarks = read_benchmarks(api) if benchmark is None else [read_benchmark(api, benchmark)]
    record: dict[str, Any] = {"benchmarks": benchmarks}
    if as_json:
        echo_json(record)
        return
    for item in benchmarks:
        show(phases_table(item))
        for phase in item["phases"] if benchmark is not None else ():
            for line in phase["visibility"]:
                typer.echo(one_line(f"{phase['name']}: {line}"))
