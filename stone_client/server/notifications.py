"""The caller's notifications on a server, and their deliveries."""

from collections.abc import Sequence
from typing import Any

from stone_base.errors import Refused
from stone_client.api import Api
from stone_client.server.sequences import Item

CHANNELS = ("email", "webhook")


def read_notifications(api: Api) -> Item:
    """Return the events, the choices and the addresses."""
    return api.read("/notifications")


def choose_events(api: Api, channel: str, kinds: Sequence[str], *, is_wanted: bool) -> Item:
    """Enable or disable these events on a channel; other choices stay. Raises `unknown_event`, `email_off`."""
    now = read_notifications(api)
    known = [str(event["kind"]) for event in now["events"]]
    if unknown := [kind for kind in kinds if kind not in known]:
        raise Refused(
            "unknown_event", f"{', '.join(unknown)[:100]!r}: no such event; this server has {', '.join(known)}"
        )
    if is_wanted and channel == "email" and not now["sends_email"]:
        raise Refused(
            "email_off", "this server sends no e-mail: its administrator has not configured it; use a webhook"
        )
    chosen = {name: list(now[name]) for name in CHANNELS}
    others = [kind for kind in chosen[channel] if kind not in kinds]
    chosen[channel] = [*others, *kinds] if is_wanted else others
    changed: Item = api.send("PUT", "/notifications/choices", json=chosen).json()
    return changed


def read_deliveries(api: Api, limit: int) -> list[dict[str, Any]]:
    """Return the last deliveries, newest first."""
    deliveries: list[dict[str, Any]] = api.read("/notifications/deliveries", limit=limit)["items"]
    return deliveries
