"""Files private to the platform's user: the umask of every process, and a check of an existing data folder.

**Conventions.** Entry points set the umask before they write; their children inherit it.
"""

import os
import stat
from pathlib import Path

from stone.errors import Refused

PRIVATE = 0o077
"""The permissions that no file has: those of the group and of others."""


def keep_private() -> int:
    """Make all files that this process creates private to its user; return the previous umask."""
    return os.umask(PRIVATE)


def open_data_folder(folder: Path) -> Refused | None:
    """Return a warning, with the remedy, if others may enter the data folder; None if it is private."""
    mode = stat.S_IMODE(folder.stat().st_mode)
    if not mode & PRIVATE:
        return None
    return Refused(
        "data_folder_open",
        f"the data folder {folder} has mode {mode:04o}, so other users of this machine may read the database and the "
        f"recordings; close it with: chmod -R go= '{folder}'",
    )
