"""Messages without the server's paths: a file has its own name, or if it was uploaded, the name of its upload.

**Conventions.** Libraries, and modules that also run without the platform, name paths in their errors. Paths below a
data folder and the folder of temporary files concern only the operator, whose log keeps them.
"""

import re
from pathlib import Path, PurePath
from tempfile import gettempdir

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.orm import Job, Upload

_FOLDERS: dict[str, None] = {}
"""The data folders that this process has opened."""
BELOW = r"/[^\s'\",;:()<>]*"
STORED = re.compile(r"\b(?:(?P<sha256>[0-9a-f]{64})\.[0-9a-f]{8}|(?P<id>[0-9a-f]{32}))\b")
"""Objects of blobs, and unfinished uploads."""
A_STORED_FILE = "a stored file"


def hide(folder: Path) -> None:
    """Hide this folder from all messages of this process."""
    _FOLDERS[str(folder)] = None


def without_paths(text: str) -> str:
    """Return the text, with each path below a hidden folder cut to its file name."""
    for folder in (*_FOLDERS, gettempdir()):
        if folder in text:
            text = re.sub(re.escape(folder) + BELOW, lambda path: PurePath(path[0]).name, text)
        if folder in _FOLDERS:
            text = text.replace(folder, "the data folder")
    return text


def called_as_uploaded(session: Session, job_id: str, text: str) -> str:
    """Return the text without paths; a file that the job's owner uploaded has the name that the owner gave."""
    owner_id = select(Job.owner_id).where(Job.id == job_id).scalar_subquery()

    def name(found: re.Match[str]) -> str:
        is_it = Upload.sha256 == found["sha256"] if found["sha256"] else Upload.id == found["id"]
        named = select(Upload.filename).where(Upload.owner_id == owner_id, is_it).order_by(Upload.id).limit(1)
        return session.scalar(named) or (A_STORED_FILE if found["sha256"] else found[0])

    return STORED.sub(name, without_paths(text))
