"""In which place the bytes of an upload are."""

from collections.abc import Iterable

from services.runtime.orm import Upload
from services.runtime.platform import Platform
from services.runtime.uploads.folder_place import FolderPlace
from services.runtime.uploads.place import Place
from services.runtime.uploads.slab_rows import STORE
from services.runtime.uploads.store_place import StorePlace


def place_of(platform: Platform, upload: Upload) -> Place:
    """Where the bytes of `upload` are, or are to come."""
    return StorePlace(platform) if upload.place == STORE else FolderPlace(platform)


def places(platform: Platform) -> tuple[Place, ...]:
    """Every place in which bytes may be."""
    return (FolderPlace(platform), StorePlace(platform))


def remove_bytes(platform: Platform, upload_ids: Iterable[str]) -> None:
    """The bytes of these uploads go, wherever they are."""
    for place in places(platform):
        for upload_id in upload_ids:
            place.remove(upload_id)
