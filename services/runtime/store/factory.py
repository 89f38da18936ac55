"""Opens the store that the settings name: an S3 bucket, or a folder on this machine."""

from services.runtime.settings import Settings
from services.runtime.store.folder import FolderStore
from services.runtime.store.own_names import hide
from services.runtime.store.protocol import Store


def open_store(settings: Settings) -> Store:
    """Return the bucket of `settings`; without one, the folder `store` in the data folder, hidden from messages."""
    hide(settings.root)
    if settings.store.s3_bucket:
        from services.runtime.store.s3 import S3Store  # importing boto3 takes most of a second

        return S3Store(settings)
    return FolderStore(settings.root / "store", settings.store.reserve_bytes)
