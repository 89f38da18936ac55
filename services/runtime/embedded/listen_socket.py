"""The API's listening socket, kept open by the supervisor across API restarts.

**Conventions.** While an API that died is started again, connections wait in the backlog instead of being refused.
"""

import os
import socket
from contextlib import suppress
from dataclasses import replace

from services.runtime.embedded.errors import PortTakenError
from services.runtime.settings import ApiSettings

BACKLOG = 1024
EVERYWHERE = {"0.0.0.0": "127.0.0.1", "::": "::1"}


def listen(api: ApiSettings) -> socket.socket:
    """A listening socket on the host and port asked for (0: any). Raises `PortTakenError`."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            api.host, api.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
    except socket.gaierror as error:
        raise PortTakenError(api.host, api.port, str(error.strerror)) from None
    listener = socket.socket(family, kind, protocol)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind(address)
        listener.listen(BACKLOG)
    except OSError as error:
        listener.close()
        raise PortTakenError(api.host, api.port, os.strerror(error.errno or 0)) from None
    return listener


def reached_at(api: ApiSettings, listener: socket.socket) -> ApiSettings:
    """The API's settings with the port it really has; a URL that was set from outside is kept."""
    port = int(listener.getsockname()[1])
    if api.url != ApiSettings().url:
        return replace(api, port=port)
    return replace(api, port=port, url=local_url(api.host, port))


def local_host(host: str) -> str:
    """The name by which this machine reaches what listens on `host`."""
    return EVERYWHERE.get(host, host)


def local_url(host: str, port: int) -> str:
    """The URL by which this machine reaches a server that listens on `host`."""
    name = local_host(host)
    return f"http://[{name}]:{port}" if ":" in name else f"http://{name}:{port}"


def close(listener: socket.socket) -> None:
    """Accept nothing more through this process's own hold of the socket."""
    with suppress(OSError):
        listener.close()
