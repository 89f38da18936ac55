"""Files that stages of a run leave in its workspace for other stages: names, and the check that they exist.

**Conventions.** `checked.npz` is `sequence.npz` with the findings of the late checks added. It is created during
labelling and published as `sequence.npz`. For several recordings, `joined.json` (`stone_files.joined_file`) describes
them; it is published with the labels, so that later stages open the recordings with the same offsets.
"""

from collections.abc import Iterable
from pathlib import Path

from stone.errors import Refused

SEQUENCE_FILE = "sequence.npz"
CHECKED_FILE = "checked.npz"
SWEEPS_FILE = "sweeps.npz"


def require_left(folder: Path, names: Iterable[str]) -> None:
    """Raise `work_gone` for the first missing file or folder."""
    for name in names:
        if not (folder / name).exists():
            raise Refused(
                "work_gone", f"{name} of this run was deleted, so the run cannot continue; process the sequence again"
            )
