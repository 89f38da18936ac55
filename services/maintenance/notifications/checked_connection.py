"""An HTTP connection to a host whose address was judged first, bounded in time whatever the other side does.

**Conventions.** A name is resolved once, every address of it is judged, and one of those judged is connected to; if
any may not be sent to, none is: a name that resolves to a public and a private address is an attack or a mistake. TLS
is of the name, not of the address. After `WITHIN_S` the socket is shut down under whoever reads or writes it. No proxy
of the environment is asked: it would resolve the name anew. What a name resolved to is not told: it may be known inside
only.
"""

import http.client
import socket
import ssl
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from ipaddress import ip_address
from threading import Timer

from services.domain.notifications.webhook_urls import is_allowed
from services.maintenance.notifications.errors import NotTakenError
from services.runtime.notification_settings import NotificationSettings

WITHIN_S = 10.0
Resolve = Callable[[str, int], list[str]]


def resolved(host: str, port: int) -> list[str]:
    """The addresses of a host, in the order the system prefers. Raises `OSError`."""
    found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    return list(dict.fromkeys(str(entry[4][0]) for entry in found))


def judged_addresses(host: str, port: int, settings: NotificationSettings, resolve: Resolve = resolved) -> list[str]:
    """The addresses of the host, all of which may be sent to. Raises `NotTakenError`, `OSError`."""
    found = resolve(host, port)
    for address in found:
        if not is_allowed(ip_address(address.partition("%")[0]), settings):
            raise NotTakenError(f"{host} is at an address that is private, of this machine or reserved")
    return found


@contextmanager
def connection_to(
    host: str, port: int, addresses: list[str], context: ssl.SSLContext | None
) -> Iterator[http.client.HTTPConnection]:
    """A connection to the first of `addresses` that answers, by TLS where there is a `context`. Raises `OSError`."""
    open_socket = _connected(addresses, port)
    timer = Timer(WITHIN_S, _shut, (open_socket,))
    timer.daemon = True
    timer.start()
    try:
        if context is not None:
            open_socket = context.wrap_socket(open_socket, server_hostname=host)
        connection = http.client.HTTPConnection(host, port)
        connection.sock = open_socket
        yield connection
    finally:
        timer.cancel()
        open_socket.close()


def _connected(addresses: list[str], port: int) -> socket.socket:
    error = OSError("it has no address")
    for address in addresses[:2]:
        try:
            return socket.create_connection((address, port), timeout=WITHIN_S / 2)
        except OSError as refusal:
            error = refusal
    raise error


def _shut(open_socket: socket.socket) -> None:
    with suppress(OSError):
        open_socket.shutdown(socket.SHUT_RDWR)
