"""`stone dataset publish`: publish the draft splits as a version that never changes."""

from typing import Annotated

import typer

from stone_client.commands.dataset.versions import VersionArgument
from stone_client.confirmation import DryRunOption, YesOption, require_confirmation, show_dry_run
from stone_client.options import ServerOption
from stone_client.streams import JsonOption, echo_json

LicenceOption = Annotated[str, typer.Option(metavar="TEXT", help="Licence of the published version.")]
ReasonOption = Annotated[str, typer.Option(metavar="TEXT", help="Reason, recorded in the audit log.")]


def publish(
    version: VersionArgument,
    licence: LicenceOption = "",
    reason: ReasonOption = "published by the stone command",
    is_confirmed: YesOption = False,
    is_dry_run: DryRunOption = False,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Publish the draft splits as a version of the dataset, permanently: a version never changes."""
    from stone_client.connection import connected
    from stone_client.server.datasets import publish_dataset, show_datasets
    from stone_client.server.publication import planned_version, publishing, show_version_plan

    with connected(server) as api:
        shown_revision = None
        if is_dry_run or not is_confirmed:
            plan = planned_version(api, version, licence)
            show_version_plan(plan, as_json=as_json)
            if is_dry_run:
                show_dry_run(publishing(plan), plan, as_json=as_json)
                return
            require_confirmation(publishing(plan), is_given=False)
            shown_revision = plan["revision"]
        record = publish_dataset(api, version, licence, reason, shown_revision)
    if as_json:
        echo_json(record)
    else:
        show_datasets(record)
