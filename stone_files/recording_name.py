"""Sequence names from recording files."""

import re
from hashlib import sha256
from pathlib import Path
from unicodedata import normalize

from stone_base.names import NAME

OTHER, DASHES, LONGEST = re.compile(r"[^A-Za-z0-9._-]"), re.compile(r"-{2,}"), 100


def sequence_name(recording: Path) -> str:
    """Return the sequence name of a recording: its file name, with dashes for characters that are not allowed.

    Accents are removed. A name without a letter or digit becomes `recording-` plus eight digits of its hash.
    """
    stem = recording.stem or recording.resolve().stem
    plain = normalize("NFKD", stem).encode("ascii", "ignore").decode()
    name = DASHES.sub("-", OTHER.sub("-", plain)).lstrip("._-")[:LONGEST]
    if NAME.fullmatch(stem):
        return stem
    return name.rstrip("._-") or f"recording-{sha256(stem.encode('utf-8', 'surrogateescape')).hexdigest()[:8]}"
