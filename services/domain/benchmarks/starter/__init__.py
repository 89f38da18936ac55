"""Starter code: a script that writes a valid submission from a manifest, for participants to begin with.

**Conventions.** `predict.txt` is the script as docs/participant.md prints it; it is data here and never imported.
"""

from functools import cache
from importlib.resources import files

FILENAME = "predict.py"


def manifest_filename(benchmark: str, phase: str) -> str:
    """The name that a phase's manifest is downloaded by, in browsers and in the steps of a first submission."""
    return f"{benchmark}-{phase}.manifest.json"


@cache
def starter_code() -> bytes:
    """The script; needs Python and numpy."""
    return files(__package__).joinpath("predict.txt").read_bytes()
