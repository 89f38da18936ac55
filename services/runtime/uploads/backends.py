"""Selects the backend that has an upload's bytes."""

from collections.abc import Iterable

from services.runtime.orm import Upload
from services.runtime.platform import Platform
from services.runtime.uploads.backend import UploadBackend
from services.runtime.uploads.folder_backend import FolderUploadBackend
from services.runtime.uploads.part_rows import STORE
from services.runtime.uploads.store_backend import StoreUploadBackend


def backend_of(platform: Platform, upload: Upload) -> UploadBackend:
    """Where the bytes of `upload` are, or are to come."""
    return StoreUploadBackend(platform) if upload.backend == STORE else FolderUploadBackend(platform)


def backends(platform: Platform) -> tuple[UploadBackend, ...]:
    """Every backend that bytes may be in."""
    return (FolderUploadBackend(platform), StoreUploadBackend(platform))


def remove_bytes(platform: Platform, upload_ids: Iterable[str]) -> None:
    """The bytes of these uploads go, wherever they are."""
    for backend in backends(platform):
        for upload_id in upload_ids:
            backend.remove(upload_id)
