"""Where the real recordings by others lie; never part of the project, so absent on most machines."""

import os
from pathlib import Path

VARIABLE = "STONE_FIELD_DATA"
ROOT = Path(__file__).resolve().parents[1]


def field_folder() -> Path:
    """The folder that the variable names, else the usual one beside the project; it need not exist."""
    return Path(os.environ.get(VARIABLE) or ROOT.parent / "shared" / "data")
