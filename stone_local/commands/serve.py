"""`stone serve`: run the whole platform on this machine."""

import os
from pathlib import Path
from typing import Annotated

import typer

from stone_client.options import DataOption, WorkersOption
from stone_client.streams import JsonOption, echo_json, echo_notice

HostOption = Annotated[str | None, typer.Option(help="Address to listen on.", show_default="127.0.0.1")]
PortOption = Annotated[
    int | None, typer.Option(min=0, max=65535, help="Port to listen on; 0 for any free port.", show_default="8080")
]
StopOption = Annotated[
    bool, typer.Option("--stop", help="Stop the server of the data folder and wait until it has ended.")
]


def serve(
    data: DataOption = None,
    host: HostOption = None,
    port: PortOption = None,
    workers: WorkersOption = None,
    is_stop: StopOption = False,
    as_json: JsonOption = False,
) -> None:
    """Run API, workers and sweeper with their own database and store until Ctrl-C; a second start resumes."""
    from stone_local.embedded_platform import Address, password_line, served, settings_for, wait_for_ctrl_c

    if is_stop:
        if host is not None or port is not None or workers is not None:
            raise typer.BadParameter("it combines with --data only", param_hint="--stop")
        _stop(data, as_json=as_json)
        return

    with served(settings_for(data, Address(host, port), workers)) as running:
        folder = running.platform.settings.root
        if running.keys.password:
            echo_notice(f"administrator: {running.keys.name}, password: {running.keys.password}")
            echo_notice("change it after the first sign-in")
        if line := password_line(running.platform.settings):
            echo_notice(line)
        echo_notice(f"{', '.join(child.program.name for child in running.children)} run; logs: {running.logs}")
        if as_json:
            echo_json({"url": running.url, "pid": os.getpid(), "data": str(folder)})
        else:
            typer.echo(running.url)
        wait_for_ctrl_c()
        echo_notice("stopping: running jobs may finish; Ctrl-C again ends them at once")


def _stop(data: Path | None, *, as_json: bool) -> None:
    """Drain the server of the data folder as Ctrl-C does. Raises `not_serving`."""
    from services.runtime.embedded.listen_socket import stop_holder
    from stone_local.embedded_platform import Address, settings_for

    folder = settings_for(data, Address(), None).root
    echo_notice("stopping: running jobs may finish")
    pid, url = stop_holder(folder)
    if as_json:
        echo_json({"stopped": {"pid": pid, "url": url}, "data": str(folder)})
    else:
        typer.echo(f"stopped: process {pid}, which served {folder} at {url}")
