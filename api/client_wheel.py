"""The wheel of the client that this platform offers: what `make wheels` put into `downloads/` beside this module.

**Conventions.** It fits by its name, which holds the platform's own release; it is read once, when the process starts.
"""

from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path

from services.runtime.code_version import RELEASE

FOLDER = Path(__file__).with_name("downloads")
FILENAME = f"stone_client-{RELEASE}-py3-none-any.whl"
OLDEST_CLIENT = "0.1.0"
"""The oldest release of the client that this server understands."""


@dataclass(frozen=True)
class ClientWheel:
    """A wheel as it is sent; its name is what pip reads its release from."""

    filename: str
    content: bytes

    @property
    def path(self) -> str:
        """Where the pages serve it."""
        return f"/downloads/{self.filename}"

    @cached_property
    def sha256(self) -> str:
        return sha256(self.content).hexdigest()


def client_wheel(folder: Path = FOLDER) -> ClientWheel | None:
    """The wheel of this release; None where none was built."""
    try:
        return ClientWheel(FILENAME, (folder / FILENAME).read_bytes())
    except FileNotFoundError:
        return None


def install_line(url: str, wheel: ClientWheel | None) -> str:
    """The one line that installs the client which fits; without a wheel, where it would be said."""
    return f"pip install {url.rstrip('/')}{wheel.path}" if wheel else f"see {url.rstrip('/')}/downloads/"
