"""Names that everybody writes alike: of sequences, and of the parts of a split."""

import re
from hashlib import sha256
from pathlib import Path
from typing import Literal
from unicodedata import normalize

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
"""A sequence's name in full; it becomes a folder's name."""

OTHER, DASHES, LONGEST = re.compile(r"[^A-Za-z0-9._-]"), re.compile(r"-{2,}"), 100


def sequence_name(recording: Path) -> str:
    """Return the name of the sequence of a recording: its file's, with a dash for what no sequence's name can have.

    Accents are dropped. A name of which no letter or digit is left becomes `recording-` and eight digits of its hash.
    """
    stem = recording.stem or recording.resolve().stem
    plain = normalize("NFKD", stem).encode("ascii", "ignore").decode()
    name = DASHES.sub("-", OTHER.sub("-", plain)).lstrip("._-")[:LONGEST]
    if NAME.fullmatch(stem):
        return stem
    return name.rstrip("._-") or f"recording-{sha256(stem.encode('utf-8', 'surrogateescape')).hexdigest()[:8]}"


Part = Literal["train", "val", "test"]
PARTS: tuple[Part, ...] = ("train", "val", "test")
