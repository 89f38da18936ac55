"""Sign-in by a browser (RFC 8628): a code is shown, somebody approves it at the server's page, a token comes.

**Conventions.** The server says how often it may be asked; who asks too often is told to, and asks less often from then
on. A server that goes away meanwhile is waited for, as long as the code is valid.
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
    """What a person needs: the code, and where it is typed; `url_with_code` spares the typing."""

    user_code: str
    url: str
    url_with_code: str

    @classmethod
    def of(cls, begun: Mapping[str, Any]) -> "ShownCode":
        return cls(begun["user_code"], begun["url"], begun["url_with_code"])


def asks_for_browser(url: str) -> bool:
    """Whether people sign in to this server with a browser: it has a provider, or no passwords.

    A server of a release before knows passwords only. Raises what `Api.send` raises.
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
    """Have a token approved in a browser, and keep it. Raises what `Api.send` raises, `access_denied` among it."""
    wanted = (*EVERYDAY, "admin") if as_administrator else EVERYDAY
    with Api(Server(url, "")) as api:
        asked = {"name": f"stone on {socket.gethostname()}"[:64], "scopes": list(wanted)}
        begun = api.send("POST", "/device-grants", json=asked).json()
        show(ShownCode.of(begun))
        secret = _awaited(api, begun["device_code"], float(begun["interval_s"]))
    identity = identity_of(url, secret)
    remember(url, secret, as_default=True)
    return identity


def _awaited(api: Api, device_code: str, interval_s: float) -> str:
    """The token's secret, once somebody approved; the server ends the waiting when the code has expired."""
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
