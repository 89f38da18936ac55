"""Starter code: a script that writes a valid submission from a manifest, for participants to begin with.

**Conventions.** `predict.txt` is the script as docs/participant.md prints it; it is data here and never imported.
"""

from functools import cache
from importlib.resources import files

FILENAME = "predict.py"


@cache
def starter_code() -> bytes:
    """The script; needs Python and numpy."""
    return files(__package__).joinpath("predict.txt").read_bytes()
