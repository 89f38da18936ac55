"""Sign-in by browser (RFC 8628): the user approves a code on the server's page, and the client receives a token.

**Conventions.** The server sets the polling interval and lengthens it if it is polled too often. If the server becomes
unreachable, polling continues while the code is valid.
"""

import socket
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from stone_client.api import Api
from stone_client.credentials import Server, remember
from stone_client.errors import ServerRefusedError, ServerUnreachableError
from stone_client.sign_in import EVERYDAY, TokenIdentity, identity_of

SLOWER_S = 5.0
NOT_FOUND = 404


@dataclass(frozen=True)
class ShownCode:
    """The code for the user and the page to enter it on; `url_with_code` contains both."""

    user_code: str
    url: str
    url_with_code: str

    @classmethod
    def of(cls, begun: Mapping[str, Any]) -> "ShownCode":
        return cls(begun["user_code"], begun["url"], begun["url_with_code"])


def asks_for_browser(url: str) -> bool:
    """Return whether users sign in to this server with a browser: it has a provider, or no passwords.

    A server of an earlier release supports passwords only. Raises what `Api.send` raises.
    """
    with Api(Server(url, "")) as api:
        try:
            ways = api.read("/sign-in")
        except ServerRefusedError as error:
            if error.status == NOT_FOUND:
                return False
            raise
    return bool(ways["provider"]) or not ways["passwords"]


def sign_in_by_browser(url: str, show: Callable[[ShownCode], None], *, as_administrator: bool) -> TokenIdentity:
    """Request a token that the user approves in a browser, and store it. Raises what `Api.send` raises, and
    `access_denied`.
    """
    wanted = (*EVERYDAY, "admin") if as_administrator else EVERYDAY
    with Api(Server(url, "")) as api:
        body = {"name": f"stone on {socket.gethostname()}"[:64], "scopes": list(wanted)}
        begun = api.send("POST", "/device-grants", json=body).json()
        show(ShownCode.of(begun))
        secret = _awaited(api, begun["device_code"], float(begun["interval_s"]))
    identity = identity_of(url, secret)
    remember(url, secret, as_default=True)
    return identity


def _awaited(api: Api, device_code: str, interval_s: float) -> str:
    """Return the token's secret after approval; the server ends the polling when the code expires."""
    while True:
        time.sleep(interval_s)
        try:
            return str(api.send("POST", "/device-grants/token", json={"device_code": device_code}).json()["secret"])
        except ServerRefusedError as error:
            if error.code == "slow_down":
                interval_s += SLOWER_S
            elif error.code not in ("authorization_pending", "rate_limited"):
                raise
        except ServerUnreachableError:
            interval_s += SLOWER_S
