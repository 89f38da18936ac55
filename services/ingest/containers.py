"""Open one file of a recording as what its first bytes say it is.

**Conventions.** A file that was compressed as a whole is unpacked into a private folder, which lives as long as what
was opened from it.
"""

from collections.abc import Callable
from pathlib import Path

from services.ingest.magic import container_of
from services.ingest.mcap_store import McapStore
from services.ingest.packed_file import unpacked_file
from services.ingest.private_folder import PrivateFolder
from services.ingest.sqlite_store import SqliteStore
from services.ingest.store import Store

STORES: dict[str, Callable[[Path], Store]] = {"mcap": McapStore, "sqlite": SqliteStore}


def opened_store(file: Path) -> Store:
    """Raises: what `container_of`, the stores and `unpacked_file` raise."""
    container = container_of(file)
    if container != "zstd":
        return STORES[container](file)
    folder = PrivateFolder()
    try:
        unpacked = unpacked_file(file, folder)
        store = STORES[container_of(unpacked)](unpacked)
    except BaseException:
        folder.close()
        raise
    folder.close_with(store)
    return store
