"""Counts of open connections by peer address, and one log line a minute about connections closed unanswered.

**Conventions.** All addresses of an IPv6 /64 count as one. Proxies in `STONE_API__TRUSTED_PROXIES` carry the
connections of many clients, so they are exempt and limit their own clients. Counts are per process.
"""

import time
from collections import Counter
from collections.abc import Callable
from ipaddress import ip_address, ip_network

import structlog
from structlog.contextvars import clear_contextvars

from api.middleware.limits import site_of
from services.runtime.settings import ApiSettings
from services.runtime.telemetry.descriptors import Descriptors

LINE_S = 60.0
Later = Callable[[float, Callable[[], None]], object]
"""`later(seconds, act)`, as an event loop's `call_later`."""

log = structlog.get_logger(__name__)


class Connections:
    """The open connections of one application, used only by its event loop."""

    def __init__(self, api: ApiSettings, monotonic_s: Callable[[], float] = time.monotonic) -> None:
        self.head_s, self._most = api.head_s, api.connections_per_address
        self._proxies = [ip_network(proxy) for proxy in api.proxies]
        self._open, self._closed = Counter[str](), Counter[str]()
        self._now_s, self._silent_until_s = monotonic_s, 0.0
        self._is_due, self._refused = False, 0
        self._descriptors = Descriptors(LINE_S, monotonic_s)

    def admit(self, host: str, descriptor: int) -> bool:
        """Count the connection; return False without counting it if its address has reached the limit."""
        self._descriptors.look(descriptor)
        site = site_of(host)
        if self._open[site] >= self._most and not self._is_proxy(host):
            return False
        self._open[site] += 1
        return True

    def leave(self, host: str) -> None:
        """Remove an admitted connection from the count."""
        site = site_of(host)
        self._open[site] -= 1
        if not self._open[site]:
            del self._open[site]

    def note_closed(self, host: str, later: Later, *, is_refused: bool) -> None:
        """Count a connection that was closed unanswered, and schedule the log line by `later`."""
        self._closed[site_of(host)] += 1
        self._refused += is_refused
        if not self._is_due:
            self._is_due = True
            later(max(0.0, self._silent_until_s - self._now_s()), self._report)

    def _report(self) -> None:
        """Log one line about all connections closed since the last line."""
        clear_contextvars()  # the context belongs to the request that triggered the line
        ((site, most),) = self._closed.most_common(1)
        write = log.warning if self._refused else log.info  # browsers open connections without using them
        count, refused = self._closed.total(), self._refused
        write("connections closed unanswered", count=count, refused=refused, address=site, of_address=most)
        self._closed.clear()
        self._is_due, self._refused, self._silent_until_s = False, 0, self._now_s() + LINE_S

    def _is_proxy(self, host: str) -> bool:
        try:
            address = ip_address(host)
        except ValueError:
            return False
        return any(address in network for network in self._proxies)
