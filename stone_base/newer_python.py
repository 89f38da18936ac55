"""Standard library names of Python 3.11 for the client on Python 3.10.

**Conventions.** The client's packages import these names from here; Python 3.11 and newer use the standard library.
"""

import sys
from datetime import timezone

UTC = timezone.utc  # noqa: UP017

if sys.version_info >= (3, 11):  # noqa: UP036
    from enum import StrEnum as StrEnum
    from hashlib import file_digest as file_digest
else:
    import hashlib
    from enum import Enum
    from typing import Any, BinaryIO

    class StrEnum(str, Enum):  # noqa: UP042
        """Enum members that equal their text values."""

        __str__ = str.__str__

    def file_digest(file: BinaryIO, name: str) -> Any:
        """Return the hash object of the remaining bytes of a file."""
        digest = hashlib.new(name)
        while piece := file.read(2**18):
            digest.update(piece)
        return digest
