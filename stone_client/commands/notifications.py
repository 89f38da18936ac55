"""`stone notifications`: choose events and channels, and list deliveries."""

from collections.abc import Mapping
from typing import Annotated, Any

import typer

from stone_base.newer_python import StrEnum
from stone_client.options import ServerOption
from stone_client.streams import JsonOption, echo_json
from stone_client.tables import plain_table, safe_text, show


class Channel(StrEnum):
    """The channels of notifications."""

    email = "email"
    webhook = "webhook"


EventsArgument = Annotated[
    list[str], typer.Argument(metavar="EVENT...", help="Events, as `stone notifications list` prints them.")
]
ByOption = Annotated[Channel, typer.Option("--by", help="The channel; set its address on your account page.")]
LimitOption = Annotated[int, typer.Option("--limit", min=1, max=200, help="Maximum number of notifications.")]


def listed(server: ServerOption = None, as_json: JsonOption = False) -> None:
    """List the events, and whether each is enabled."""
    from stone_client.connection import connected
    from stone_client.server.notifications import read_notifications

    with connected(server) as api:
        settings = read_notifications(api)
    _say(settings, as_json)


def on(events: EventsArgument, by: ByOption, server: ServerOption = None, as_json: JsonOption = False) -> None:
    """Enable notifications."""
    _choose(events, by, server, as_json, is_wanted=True)


def off(events: EventsArgument, by: ByOption, server: ServerOption = None, as_json: JsonOption = False) -> None:
    """Disable notifications."""
    _choose(events, by, server, as_json, is_wanted=False)


def deliveries(limit: LimitOption = 20, server: ServerOption = None, as_json: JsonOption = False) -> None:
    """List the latest deliveries with their results."""
    from stone_client.connection import connected
    from stone_client.server.notifications import read_deliveries

    with connected(server) as api:
        records = read_deliveries(api, limit)
    if as_json:
        echo_json({"deliveries": records})
        return
    table = plain_table("deliveries", "event", "by", "state", "tries", "answer")
    for delivery in records:
        table.add_row(
            delivery["kind"],
            delivery["channel"],
            delivery["state"],
            str(delivery["tries"]),
            safe_text(delivery["answer"]),
        )
    show(table)


def _choose(events: list[str], by: Channel, server: str | None, as_json: bool, *, is_wanted: bool) -> None:
    from stone_client.connection import connected
    from stone_client.server.notifications import choose_events

    with connected(server) as api:
        settings = choose_events(api, by.value, events, is_wanted=is_wanted)
    _say(settings, as_json)


def _say(settings: Mapping[str, Any], as_json: bool) -> None:
    if as_json:
        echo_json(dict(settings))
        return
    table = plain_table("events", "event", "e-mail", "webhook", "when")
    for event in settings["events"]:
        marks = ["yes" if event["kind"] in settings[channel] else "" for channel in ("email", "webhook")]
        table.add_row(event["kind"], *marks, safe_text(event["title"]))
    show(table)
    typer.echo(f"e-mail to: {_email(settings)}; webhook: {_webhook(settings)}", err=True)


def _email(settings: Mapping[str, Any]) -> str:
    address = settings["email_address"]
    if address is None:
        return "no address yet" if settings["sends_email"] else "e-mail is not configured on this platform"
    return f"{address['address']}{'' if address['is_verified'] else ' (not verified yet)'}"


def _webhook(settings: Mapping[str, Any]) -> str:
    target = settings["webhook_target"]
    if target is None:
        return "none yet"
    return f"{target['url']}{' (disabled)' if target['disabled_at'] else ''}"
