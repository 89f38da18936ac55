"""The folder backend of uploads: one file per upload in a folder shared by API and workers."""

import os
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from sqlalchemy.orm import Session

from services.runtime.orm import Upload
from services.runtime.platform import Platform
from services.runtime.uploads.duplicates import duplicates_of
from services.runtime.uploads.files import LockedUploadFile, make_file, offset_of, remove_file, sync_folder, upload_file

OURS = re.compile(r"([0-9a-f]{32})(?:\.unverified)?")
ORPHAN_S = 3600.0


class FolderUploadBackend:
    """`Place` of the uploads folder."""

    def __init__(self, platform: Platform) -> None:
        self._platform = platform

    def begin(self, upload: Upload) -> bool:
        """An empty file; or a second name for the same bytes on disk, where the owner has the declared file already.

        Raises `DiskFullError`.
        """
        path = self._path(upload.id)
        if self._link_duplicate(upload, path):
            return True
        make_file(path)
        return False

    def enter(self, session: Session, upload: Upload) -> bool:
        return False

    def offset_of(self, upload_id: str) -> int:
        return offset_of(self._path(upload_id))

    def hold(self, upload: Upload) -> LockedUploadFile:
        return LockedUploadFile(self._path(upload.id))

    def remove(self, upload_id: str) -> None:
        remove_file(self._path(upload_id))

    @contextmanager
    def local(self, upload: Upload) -> Iterator[Path]:
        """The file itself."""
        path = self._path(upload.id)
        path.stat()
        yield path

    def holding(self) -> Iterator[str]:
        """Uploads that have a file, or a mark whose file is gone; twice those that have both."""
        folder = self._platform.settings.uploads_folder
        if not folder.is_dir():
            return
        with os.scandir(folder) as entries:
            for entry in entries:
                if match := OURS.fullmatch(entry.name):
                    yield match[1]

    def is_forgotten(self, upload_id: str) -> bool:
        with suppress(FileNotFoundError):
            return time.time() - self._path(upload_id).stat().st_mtime > ORPHAN_S
        return True

    def _path(self, upload_id: str) -> Path:
        return upload_file(self._platform.settings, upload_id)

    def _link_duplicate(self, upload: Upload, path: Path) -> bool:
        """Whether the owner had the declared bytes already, and `path` names them now."""
        if not upload.declared_sha256:
            return False
        path.parent.mkdir(parents=True, exist_ok=True)
        for duplicate in duplicates_of(self._platform, upload):
            try:
                os.link(duplicate, path)
            except OSError:  # consumed or collected meanwhile, or on another filesystem: then it is sent again
                continue
            sync_folder(path.parent)
            return True
        return False
