"""Where the first administrator's password is, for whoever signs in on the machine that serves the platform.

**Conventions.** Only the path is told, never the password: a page is read by every process and tunnel of the machine,
the file by its owner only.
"""

from dataclasses import dataclass
from ipaddress import ip_address
from pathlib import Path
from urllib.parse import urlsplit

from fastapi import Request

from api.deps import platform_of
from services.runtime.embedded.first_start import ADMINISTRATOR, first_password_file

LOCAL_NAME = "localhost"


@dataclass(frozen=True)
class FirstPassword:
    """The administrator's name and the file that holds the password of the first start."""

    administrator: str
    file: Path


def first_password_of(request: Request) -> FirstPassword | None:
    """None unless the file exists and the platform, the address asked for and the reader are all on loopback."""
    settings = platform_of(request).settings
    file = first_password_file(settings)
    reader = request.client.host if request.client else ""
    hosts = (urlsplit(settings.api.url).hostname, request.url.hostname, reader)
    return FirstPassword(ADMINISTRATOR, file) if file and all(map(_is_loopback, hosts)) else None


def _is_loopback(host: str | None) -> bool:
    try:
        return ip_address(host or "").is_loopback
    except ValueError:
        return host == LOCAL_NAME
