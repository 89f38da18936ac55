"""`stone datasets`: versions of the dataset, listed, published, downloaded."""

from pathlib import Path
from typing import Annotated, Any

import typer

from stone_client.confirmation import DryRunOption, YesOption, require_confirmation, show_dry_run
from stone_client.options import ServerOption
from stone_client.streams import JsonOption, echo_json

VersionArgument = Annotated[str | None, typer.Argument(metavar="[VERSION]", help="A version's name; else all.")]
CreateOption = Annotated[bool, typer.Option("--create", help="Publish the current splits as VERSION.")]
LicenceOption = Annotated[str, typer.Option(metavar="TEXT", help="Licence of the published version.")]
ReasonOption = Annotated[str, typer.Option(metavar="TEXT", help="Reason, recorded in the audit log.")]
DownloadOption = Annotated[
    Path | None,
    typer.Option(
        "--download", metavar="DIR", file_okay=False, help="Download manifest, train and val; resumes if interrupted."
    ),
]
InputsOption = Annotated[
    bool, typer.Option("--inputs", help="With --download: also the sensor data, one tar per sequence.")
]


def datasets(
    version: VersionArgument = None,
    create: CreateOption = False,
    licence: LicenceOption = "",
    reason: ReasonOption = "published by the stone command",
    download: DownloadOption = None,
    inputs: InputsOption = False,
    is_confirmed: YesOption = False,
    is_dry_run: DryRunOption = False,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """List the versions of the dataset or show one; publish one (it never changes); download train and val."""
    from stone_client.connection import connected
    from stone_client.progress import transferred
    from stone_client.server.datasets import (
        download_dataset,
        download_dataset_inputs,
        publish_dataset,
        read_dataset,
        read_datasets,
        show_datasets,
    )
    from stone_client.server.publication import planned_version, publishing, show_version_plan

    if version is None and (create or download is not None):
        raise typer.BadParameter("which version?", param_hint="VERSION")
    if inputs and download is None:
        raise typer.BadParameter("it also needs --download", param_hint="--inputs")
    if is_dry_run and not create:
        raise typer.BadParameter("it also needs --create", param_hint="--dry-run")
    with connected(server) as api:
        if create and (is_dry_run or not is_confirmed):
            plan = planned_version(api, str(version), licence)
            show_version_plan(plan, as_json=as_json)
            if is_dry_run:
                show_dry_run(publishing(plan), plan, as_json=as_json)
                return
            require_confirmation(publishing(plan), is_given=False)
        if version is None:
            record: dict[str, Any] = {"datasets": read_datasets(api)}
        else:
            record = publish_dataset(api, version, licence, reason) if create else read_dataset(api, version)
            if download is not None:
                with transferred() as progress:
                    record["files"] = download_dataset(api, record, download, progress)
                    if inputs:
                        record["inputs"] = download_dataset_inputs(api, record, download, progress)
    if as_json:
        echo_json(record)
    else:
        show_datasets(record)
