"""Where webhooks are sent: to public addresses by https, and to what the administrator names; nowhere else."""

from ipaddress import ip_address

import pytest

from services.domain.notifications.errors import BadWebhookUrlError
from services.domain.notifications.webhooks import LONGEST_URL, checked_url, is_allowed, rotate_secret, set_webhook
from services.runtime.notification_settings import NotificationSettings
from services.runtime.platform import Platform
from testing.refusals import refused_as
from tests.services.runtime.jobs.steps import an_owner

STRICT = NotificationSettings()
REFUSED = [
    "127.0.0.1", "127.255.255.254", "0.0.0.0", "10.0.0.1", "172.16.0.1", "172.31.255.255", "192.168.1.1",
    "169.254.169.254", "100.64.0.1", "192.0.0.1", "192.0.2.1", "198.18.0.1", "198.51.100.1", "203.0.113.1",
    "224.0.0.1", "239.255.255.255", "240.0.0.1", "255.255.255.255",
    "192.0.0.192", "192.0.0.9", "192.31.196.1", "192.52.193.1", "192.88.99.1", "192.88.99.2", "192.175.48.1",
    "::", "::1", "::ffff:127.0.0.1", "::ffff:8.8.8.8", "::127.0.0.1", "64:ff9b::7f00:1", "64:ff9b:1::1",
    "2002:7f00:1::1", "2002:808:808::1", "2001::1", "2001:db8::1", "fc00::1", "fd12:3456::1", "fe80::1", "fec0::1",
    "ff02::1", "ff0e::1", "100::1", "100:0:0:1::1", "64:ff9b::808:808", "2001:1::1", "2001:2::1", "2001:3::1",
    "2001:4:112::1", "2001:10::1", "2001:20::1", "2001:30::1", "2620:4f:8000::1", "3ffe::1", "3fff::1",
    "3fff:fff:ffff::1", "5f00::1", "4000::1", "::ffff:0:7f00:1", "2606:4700::5efe:a00:1", "2606:4700::200:5efe:a00:1",
]  # fmt: skip


@pytest.mark.parametrize("address", REFUSED)
def test_no_address_of_this_machine_its_network_or_a_special_purpose_is_sent_to(address: str) -> None:
    assert not is_allowed(ip_address(address), STRICT)
    host = f"[{address}]" if ":" in address else address
    with pytest.raises(BadWebhookUrlError):
        checked_url(f"https://{host}/hooks", STRICT)


@pytest.mark.parametrize(
    "address",
    [
        *("1.1.1.1", "93.184.215.14", "192.0.1.1", "192.88.98.255", "192.88.100.0", "223.255.255.255"),
        *("2606:4700:4700::1111", "2a00:1450:4001:80b::200e", "2001:200::1", "3ffd::1"),
    ],
)
def test_public_addresses_are_sent_to(address: str) -> None:
    assert is_allowed(ip_address(address), STRICT)


def test_a_network_that_the_administrator_names_is_sent_to_and_its_neighbour_is_not() -> None:
    lab = NotificationSettings(webhook_networks="10.1.0.0/16, fd00:1::/32")
    assert is_allowed(ip_address("10.1.2.3"), lab)
    assert is_allowed(ip_address("fd00:1::7"), lab)
    assert not is_allowed(ip_address("10.2.0.1"), lab)
    assert not is_allowed(ip_address("127.0.0.1"), lab)


@pytest.mark.parametrize(
    "url",
    [
        "http://chat.example.org/x", "ftp://chat.example.org/x", "file:///etc/passwd", "gopher://x/", "javascript:x",
        "https://", "https:///x", "//chat.example.org/x", "chat.example.org", "", "https://[::1", "https://h:99999/",
        "https://h:0/", "https://user:secret@chat.example.org/", "https://user@chat.example.org/",
        "https://chat.example.org/#x", "https://chat.example.org/a b", "https://chat.example.org/\r\nX: y",
        "https://chat.example.org\\@evil.org/", "https://чат.example.org/", "https://h/" + "x" * LONGEST_URL,
    ],
)  # fmt: skip
def test_a_url_that_is_not_plainly_https_to_a_host_is_refused(url: str) -> None:
    with pytest.raises(BadWebhookUrlError):
        checked_url(url, STRICT)


@pytest.mark.parametrize("host", ["2130706433", "0x7f000001", "0177.0.0.1", "127.1", "localhost", "metadata.internal"])
def test_a_name_or_an_odd_spelling_is_left_to_be_judged_when_it_is_resolved(host: str) -> None:
    assert checked_url(f"https://{host}/x", STRICT).hostname == host


def test_http_is_allowed_where_the_administrator_allows_it() -> None:
    assert checked_url("http://chat.example.org:8065/hooks/x", NotificationSettings(allows_http=True)).port == 8065


def test_every_url_and_every_wish_gives_a_secret_of_its_own(platform: Platform) -> None:
    owner = an_owner(platform)
    with platform.database.transaction() as session:
        with refused_as("no_webhook"):
            rotate_secret(session, owner)
        first = set_webhook(session, owner, "https://chat.example.org/a", STRICT).secret
        second = set_webhook(session, owner, "https://chat.example.org/b", STRICT).secret
        third = rotate_secret(session, owner).secret
    assert len({first, second, third}) == 3
    assert all(one.startswith("whsec_") for one in (first, second, third))
