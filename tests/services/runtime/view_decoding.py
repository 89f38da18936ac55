"""A decoder of the viewer's formats that shares nothing with their writer."""

import struct
from typing import Any

import zstandard


class Read:
    """The content of one frame, value after value."""

    def __init__(self, packed: bytes, magic: bytes) -> None:
        self.content = zstandard.ZstdDecompressor().decompress(packed)
        self.at = 4
        assert self.content[:4] == magic

    def values(self, form: str, count: int) -> list[Any]:
        """The next so many values of this form (`struct`)."""
        found = struct.unpack_from(f"<{count}{form}", self.content, self.at)
        self.at += struct.calcsize(f"<{count}{form}")
        return list(found)

    def is_over(self) -> bool:
        return self.at == len(self.content)
