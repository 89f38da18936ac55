"""Which URLs and which Internet addresses webhooks are sent to.

**Conventions.** A URL is anybody's who has an account. What it resolves to is judged when it is connected to, and the
judged address is what is connected to (`services/maintenance/notifications/channels.py`): a name that
resolves otherwise a moment later leads nowhere else. Allowed are globally reachable unicast addresses (IANA special
purpose registries, RFC 6890), but none that carries an IPv4 address within IPv6; and those of networks that the
administrator names.
"""

from ipaddress import IPv4Address, IPv6Address, IPv6Network, ip_address, ip_network
from urllib.parse import SplitResult, urlsplit

from services.domain.notifications.errors import BadWebhookUrlError
from services.runtime.notification_settings import NotificationSettings

LONGEST_URL = 1000
Address = IPv4Address | IPv6Address
NAT64 = (IPv6Network("64:ff9b::/96"), IPv6Network("64:ff9b:1::/48"))


def checked_url(url: str, settings: NotificationSettings) -> SplitResult:
    """The parts of a URL that may be sent to, as far as it says itself. Raises `BadWebhookUrlError`."""
    if len(url) > LONGEST_URL or not url.isascii() or not url.isprintable() or " " in url or "\\" in url:
        raise BadWebhookUrlError(f"a URL has at most {LONGEST_URL} characters, all of them printable ASCII, no blank")
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise BadWebhookUrlError(f"the URL cannot be read ({error})") from None
    allowed = ("https", "http") if settings.allows_http else ("https",)
    if parts.scheme not in allowed:
        raise BadWebhookUrlError(f"its URL begins with {' or '.join(allowed)}, not {parts.scheme[:20]!r}")
    if not host or port == 0 or parts.fragment:
        raise BadWebhookUrlError("its URL needs a host, no port 0 and no fragment, as https://chat.example.org/hooks/x")
    if parts.username is not None or parts.password is not None:
        raise BadWebhookUrlError("its URL names a user; a secret belongs into the path, as chat servers have it")
    _refuse_literal(host, settings)
    return parts


def is_allowed(address: Address, settings: NotificationSettings) -> bool:
    """Whether requests may be sent to this address."""
    if any(address in ip_network(network) for network in settings.networks):
        return True
    return _is_public(address)


def _refuse_literal(host: str, settings: NotificationSettings) -> None:
    """An address that stands in the URL itself is refused at once; a name is resolved when it is sent to."""
    try:
        address = ip_address(host)
    except ValueError:
        return
    if not is_allowed(address, settings):
        raise BadWebhookUrlError(f"{address} is private, of this machine or reserved, and may not be sent to")


def _is_public(address: Address) -> bool:
    if isinstance(address, IPv6Address) and (_carries_ipv4(address) or address.is_site_local):
        return False
    return address.is_global and not (address.is_multicast or address.is_reserved)


def _carries_ipv4(address: IPv6Address) -> bool:
    """Mapped, 6to4, Teredo or NAT64: where it leads is another's to say."""
    tunnelled = (address.ipv4_mapped, address.sixtofour, address.teredo)
    return any(one is not None for one in tunnelled) or any(address in network for network in NAT64)
