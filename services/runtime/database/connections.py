"""Connections of a process to the database: an API process has no more threads that may hold one than connections.

**Conventions.** A thread holds one at most. Whoever is given a thread is given a connection too: with more threads the
last of them would wait for it as long as the pool lets them, and then be refused.
"""

MORE_REQUESTS = 20
"""Threads that answer requests beyond the connections that are kept open (`STONE_DATABASE__POOL_SIZE`)."""
ROW_READERS = 8
"""Threads that answer lists (`api/row_readers.py`): while one runs Python, the others may wait for the database."""
UPLOADS = 16
"""Threads that take uploads (`api/tus/body_stream.py`)."""
ALONE = 3
"""Threads with a purpose of their own: event streams, the probe of the database, counts."""


def request_threads(pool_size: int) -> int:
    """The number of threads that answer whatever has none of its own."""
    return pool_size + MORE_REQUESTS


def most_connections(pool_size: int) -> int:
    """How many a process has open at most, of which `pool_size` are kept."""
    return request_threads(pool_size) + ROW_READERS + UPLOADS + ALONE
