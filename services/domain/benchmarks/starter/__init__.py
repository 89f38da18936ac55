"""Starter code for participants: a script that writes a valid submission from a manifest.

**Conventions.** `predict.txt` is the script as printed in docs/participant.md; it is data and never imported.
"""

from functools import cache
from importlib.resources import files

FILENAME = "predict.py"


def manifest_filename(benchmark: str, phase: str) -> str:
    """Return the download name of a phase's manifest, for browsers and the steps of a first submission."""
    return f"{benchmark}-{phase}.manifest.json"


@cache
def starter_code() -> bytes:
    """Return the script, which needs Python and numpy."""
    return files(__package__).joinpath("predict.txt").read_bytes()
