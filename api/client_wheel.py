"""The wheel of the client that this platform offers, which `make wheels` puts into `downloads/` beside this module.

**Conventions.** Its file name contains the platform's own release. The wheel is read once, when the process starts.
"""

from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path

from services.runtime.code_version import RELEASE

FOLDER = Path(__file__).with_name("downloads")
FILENAME = f"stone_client-{RELEASE}-py3-none-any.whl"
OLDEST_CLIENT = "0.1.0"
"""The oldest client release that this server supports."""


@dataclass(frozen=True)
class ClientWheel:
    """A wheel; pip reads the release from its name."""

    filename: str
    content: bytes

    @property
    def path(self) -> str:
        """The path that the pages serve the wheel at."""
        return f"/downloads/{self.filename}"

    @cached_property
    def sha256(self) -> str:
        return sha256(self.content).hexdigest()


def client_wheel(folder: Path = FOLDER) -> ClientWheel | None:
    """Return the wheel of this release, or None if none was built."""
    try:
        return ClientWheel(FILENAME, (folder / FILENAME).read_bytes())
    except FileNotFoundError:
        return None


def install_line(url: str, wheel: ClientWheel | None) -> str:
    """Return the command that installs the matching client; without a wheel, the address of the downloads page."""
    return f"pip install {url.rstrip('/')}{wheel.path}" if wheel else f"see {url.rstrip('/')}/downloads/"
