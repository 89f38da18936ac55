"""Files of the platform are for its own user: the mask of every process, and a look at a data folder that stood before.

**Conventions.** Entry points set the mask before they write; what they start inherits it.
"""

import os
import stat
from pathlib import Path

from stone.errors import Refused

PRIVATE = 0o077
"""The permissions that nothing gives: those of the group and of others."""


def keep_private() -> int:
    """From now on this process gives nobody else access to what it writes; the mask before."""
    return os.umask(PRIVATE)


def open_data_folder(folder: Path) -> Refused | None:
    """The warning of a data folder that others may enter, with the way to close it; None of a private one."""
    mode = stat.S_IMODE(folder.stat().st_mode)
    if not mode & PRIVATE:
        return None
    return Refused(
        "data_folder_open",
        f"the data folder {folder} has mode {mode:04o}, so other users of this machine may read the database and the "
        f"recordings; close it by: chmod -R go= '{folder}'",
    )
