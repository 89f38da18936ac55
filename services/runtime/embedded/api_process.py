"""The API's process: uvicorn on the supervisor's socket.

**Conventions.** Two arguments: the socket's descriptor, seconds for the last replies.
"""

import services.runtime.processes.seldom_collected
import services.runtime.processes.sound_settings  # noqa: F401

# isort: split

import socket
import sys

import uvicorn

from services.runtime.processes.api import application, options
from services.runtime.processes.private_files import keep_private
from services.runtime.settings import Settings
from services.runtime.telemetry.descriptors import raise_descriptor_limit


def main(descriptor: int, replies_s: int) -> None:
    """Serve until SIGTERM, with pages unless the settings disable them; then replies may take `replies_s` more."""
    keep_private()
    raise_descriptor_limit()
    settings = Settings()
    config = uvicorn.Config(application(settings), **options(settings, replies_s))
    uvicorn.Server(config).run(sockets=[socket.socket(fileno=descriptor)])


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
