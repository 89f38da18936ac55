"""Errors of labels that cannot be exported."""

from pathlib import Path

from stone.errors import Refused


def damaged_labels(path: Path, reason: str) -> Refused:
    return Refused(
        "damaged_labels", f"{path} cannot be read: {reason[:200]}; was it changed by hand? Label the recording again"
    )
