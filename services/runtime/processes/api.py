"""The API's process in a deployment: `python -m services.runtime.processes.api`.

**Conventions.** It listens on `STONE_API__HOST` and `STONE_API__PORT`. `STONE_API__TRUSTED_PROXIES` names the proxies
whose client addresses it trusts, uvicorn's `WEB_CONCURRENCY` sets the number of processes. On SIGTERM it accepts no
more connections; replies may take `REPLIES_S`, then they are cut, uploads at a known byte.
"""

import services.runtime.processes.seldom_collected
import services.runtime.processes.sound_settings  # noqa: F401

# isort: split

from typing import Any

import uvicorn

from services.runtime.processes.private_files import keep_private
from services.runtime.settings import Settings
from services.runtime.telemetry.descriptors import raise_descriptor_limit
from services.runtime.telemetry.log_lines import speak_json

SITE, API = "web.main:from_environment", "api.main:from_environment"
PROTOCOL = "api.middleware.heads:BoundedHeads"
REPLIES_S = 20


def application(settings: Settings) -> str:
    """Return the application that uvicorn loads: the API, with pages unless the settings disable them."""
    return SITE if settings.api.pages else API


def options(settings: Settings, replies_s: int) -> dict[str, Any]:
    """Return the options of uvicorn for any address.

    Its own `X-Forwarded-For` is right with addresses and networks named. With "*" it uses the left-most address, and
    the settings refuse "*" (`tests/services/runtime/processes/test_trusted_proxies.py`).
    """
    return {
        "factory": True,
        "loop": "uvloop",
        "http": PROTOCOL,
        "ws": "none",  # WebSockets would bypass the bounds of connections
        "forwarded_allow_ips": settings.api.proxies,
        "timeout_graceful_shutdown": replies_s,
        "server_header": False,
        "access_log": False,
    }


def main() -> None:
    from services.runtime.processes.startup import await_schema

    keep_private()
    speak_json()
    raise_descriptor_limit()
    settings = Settings()
    await_schema(settings)
    uvicorn.run(
        application(settings),
        host=settings.api.host,
        port=settings.api.port,
        log_config=None,
        **options(settings, REPLIES_S),
    )


if __name__ == "__main__":
    main()
