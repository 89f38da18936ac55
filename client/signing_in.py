"""From a name and a password, or a token, to credentials that the other commands use."""

import socket
from dataclasses import dataclass
from typing import Any

from client.api import Api
from client.credentials import Server, remember

EVERYDAY = ("read", "upload", "submit")


@dataclass(frozen=True)
class SignedIn:
    """Who the token speaks for."""

    url: str
    name: str
    role: str
    scopes: tuple[str, ...]

    def as_record(self) -> dict[str, Any]:
        return {"url": self.url, "name": self.name, "role": self.role, "scopes": list(self.scopes)}


def sign_in_by_token(url: str, token: str) -> SignedIn:
    """Keep a token that the server knows. Raises what `Api.send` raises."""
    with Api(Server(url, token)) as api:
        me = api.read("/me")
    remember(url, token, as_default=True)
    return SignedIn(url, me["name"], me["role"], tuple(me["scopes"]))


def sign_in_by_password(url: str, name: str, password: str, *, as_administrator: bool) -> SignedIn:
    """Have a token issued for this machine, and keep it; the password is not kept. Raises what `Api.send` raises."""
    with Api(Server(url, "")) as api:
        session = api.send("POST", "/sessions", json={"name": name, "password": password}).json()
        own = {"X-CSRF-Token": session["csrf_token"]}
        wanted = (*EVERYDAY, "admin") if as_administrator else EVERYDAY
        held = api.read("/me")["scopes"]
        body = {"name": f"stone on {socket.gethostname()}"[:64], "scopes": [scope for scope in wanted if scope in held]}
        token = api.send("POST", "/tokens", json=body, headers=own).json()
        api.send("DELETE", "/sessions/current", headers=own)
    remember(url, token["secret"], as_default=True)
    return SignedIn(url, session["name"], session["role"], tuple(token["scopes"]))
