"""Files that stages of a run leave for others in its workspace: names, and the check that they are there.

**Conventions.** `checked.npz` is `sequence.npz` with what the late checks found among its findings: it is made while
the sequence is labelled, and is what is published under the name of the other. Of several recordings the `joined.json`
that describes them (`stone_files.joined_file`) lies beside these and is published with the labels: what is made later
opens the recordings with the offsets of those labels.
"""

from collections.abc import Iterable
from pathlib import Path

from stone.errors import Refused

SEQUENCE_FILE = "sequence.npz"
CHECKED_FILE = "checked.npz"
SWEEPS_FILE = "sweeps.npz"


def require_left(folder: Path, names: Iterable[str]) -> None:
    """Raises `work_gone` for the first of these files or folders that is not there."""
    for name in names:
        if not (folder / name).exists():
            raise Refused(
                "work_gone", f"{name} of this run was deleted, so the run cannot continue; process the sequence again"
            )
