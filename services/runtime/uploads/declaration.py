"""The client's declaration of a file to upload, validated.

**Conventions.** Everything here comes from outside. Nothing is repaired: a name that needs cleaning is refused, so
that what the platform shows is what the owner called it.
"""

import re
import unicodedata
from dataclasses import dataclass

from services.runtime.uploads.errors import BadMetadataError

PURPOSES = ("recording", "calibration", "submission", "ground_truth", "dataset")
LONGEST_NAME_BYTES = 255
SHA256 = re.compile(r"[0-9a-f]{64}")
TARGET = re.compile(r"[A-Za-z0-9_-]{0,64}")
UNSEEN = ("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp")


@dataclass(frozen=True)
class UploadDeclaration:
    """A file to come. `sha256` and `target_id` may be empty. Raises `BadMetadataError`."""

    filename: str
    purpose: str
    length_bytes: int
    target_id: str = ""
    sha256: str = ""

    def __post_init__(self) -> None:
        check_filename(self.filename)
        if self.purpose not in PURPOSES:
            raise BadMetadataError("purpose", self.purpose, f"one of {', '.join(PURPOSES)}")
        if not TARGET.fullmatch(self.target_id):
            raise BadMetadataError("target_id", self.target_id, "an id of at most 64 letters, digits, _ and -")
        if self.sha256 and not SHA256.fullmatch(self.sha256):
            raise BadMetadataError("sha256", self.sha256, "64 lowercase hex digits")


def check_filename(name: str) -> None:
    """Raises `BadMetadataError` unless it is a plain last component of a path, printable, at most 255 bytes."""
    if not name.strip() or name in (".", ".."):
        raise BadMetadataError("filename", name, "the name of a file")
    if len(name.encode("utf-8", "surrogatepass")) > LONGEST_NAME_BYTES:
        raise BadMetadataError("filename", name, f"at most {LONGEST_NAME_BYTES} bytes of UTF-8")
    if "/" in name or "\\" in name:
        raise BadMetadataError("filename", name, "a name without folders")
    if any(unicodedata.category(character) in UNSEEN for character in name):
        raise BadMetadataError("filename", name, "no control, formatting or unassigned characters")
