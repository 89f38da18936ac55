"""The folder of real recordings by others; never part of the project, so absent on most machines."""

import os
from pathlib import Path

VARIABLE = "STONE_FIELD_DATA"
ROOT = Path(__file__).resolve().parents[1]


def field_folder() -> Path:
    """Return the folder that the variable names, or the default folder beside the project; it need not exist."""
    return Path(os.environ.get(VARIABLE) or ROOT.parent / "shared" / "data")
