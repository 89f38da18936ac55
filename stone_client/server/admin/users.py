"""Users of a server, by name or id, for administrators."""

from typing import cast

from stone_base.errors import Refused
from stone_client.api import Api
from stone_client.server.ids import is_id, is_short_id, whole_id
from stone_client.server.sequences import Item


def user_named(api: Api, named: str) -> Item:
    """Return the user with this name, id or short id. Raises `unknown_user`, `ambiguous_id`."""
    for user in [] if is_id(named) else api.pages("/admin/users", name=named):
        if user["name"] == named:
            return cast(Item, user)
    by_id = {str(user["id"]): user for user in api.pages("/admin/users")} if is_id(named) or is_short_id(named) else {}
    user_id = named if named in by_id else whole_id(named, by_id)
    if user_id is not None:
        return cast(Item, by_id[user_id])
    raise Refused(
        "unknown_user", f"{named[:80]!r} is not a user's name or id; `stone admin users list` lists all users"
    )
