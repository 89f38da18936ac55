"""What the commands need to open a sequence, imported late because it loads the readers."""

from services.ingest.opening import open_sequence

__all__ = ["open_sequence"]
