"""Users of a server, by name or id, for administrators."""

from stone_base.errors import Refused
from stone_client.api import Api
from stone_client.server.ids import is_id
from stone_client.server.sequences import Item


def user_named(api: Api, named: str) -> Item:
    """Return the user with this name or id. Raises `unknown_user`."""
    query = {} if is_id(named) else {"name": named}
    for user in api.pages("/users", **query):
        if named in (user["id"], user["name"]):
            found: Item = user
            return found
    raise Refused("unknown_user", f"{named[:80]!r} is no user's name or id; `stone admin users list` lists them")
