"""Opens one file of a recording by the type that its first bytes show.

**Conventions.** A file that was compressed as a whole is unpacked into a private folder, which lives as long as the
store that was opened from it.
"""

from collections.abc import Callable
from pathlib import Path

from stone_recordings.bags.db3.store import SqliteStore
from stone_recordings.bags.magic import container_of
from stone_recordings.bags.mcap.store import McapStore
from stone_recordings.bags.message_store import MessageStore
from stone_recordings.bags.private_folder import PrivateFolder, unpacked_file
from stone_recordings.bags.ros1.store import Ros1Store

STORES: dict[str, Callable[[Path], MessageStore]] = {"mcap": McapStore, "sqlite": SqliteStore, "ros1": Ros1Store}


def opened_store(file: Path) -> MessageStore:
    """Open the file. Raises: the errors of `container_of`, the stores and `unpacked_file`."""
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
