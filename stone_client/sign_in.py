"""Sign-in: a name and a password, or a token, become credentials for the other commands."""

import socket
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from stone_client.api import Api
from stone_client.credentials import Server, remember

EVERYDAY = ("read", "upload", "submit")


@dataclass(frozen=True)
class TokenIdentity:
    """The user of the token."""

    url: str
    name: str
    role: str
    scopes: tuple[str, ...]

    def as_record(self) -> dict[str, Any]:
        return {"url": self.url, "name": self.name, "role": self.role, "scopes": list(self.scopes)}


def sign_in_by_token(url: str, token: str) -> TokenIdentity:
    """Store a token that the server accepts. Raises what `Api.send` raises."""
    identity = identity_of(url, token)
    remember(url, token, as_default=True)
    return identity


def identity_of(url: str, token: str) -> TokenIdentity:
    """Return the user of the token. Raises what `Api.send` raises."""
    with Api(Server(url, token)) as api:
        me = api.read("/me")
    return TokenIdentity(url, me["name"], me["role"], tuple(me["scopes"]))


def sign_in_by_password(url: str, name: str, password: str, *, as_administrator: bool) -> TokenIdentity:
    """Request a token for this machine and store it; the password is not stored. Raises what `Api.send` raises."""
    wanted = (*EVERYDAY, "admin") if as_administrator else EVERYDAY
    token = _issued(url, (name, password), wanted)
    remember(url, token["secret"], as_default=True)
    return TokenIdentity(url, token["user"], token["role"], tuple(token["scopes"]))


@contextmanager
def administering(url: str, name: str, password: str) -> Iterator[Api]:
    """Yield an API with every scope of the user's role; its token is revoked at the end."""
    token = _issued(url, (name, password), (*EVERYDAY, "admin"))
    with Api(Server(url, token["secret"])) as api:
        try:
            yield api
        finally:
            api.send("DELETE", "/tokens/current")


def _issued(url: str, sign_in: tuple[str, str], wanted: Iterable[str]) -> dict[str, Any]:
    """Return a new token of the user (name, password) with the wanted scopes that their role has."""
    name, password = sign_in
    with Api(Server(url, "")) as api:
        session = api.send("POST", "/sessions", json={"name": name, "password": password}).json()
        own = {"X-CSRF-Token": session["csrf_token"]}
        held = api.read("/me")["scopes"]
        body = {"name": f"stone on {socket.gethostname()}"[:64], "scopes": [scope for scope in wanted if scope in held]}
        token = api.send("POST", "/tokens", json=body, headers=own).json()
        api.send("DELETE", "/sessions/current", headers=own)
    return {**token, "user": session["name"], "role": session["role"]}
