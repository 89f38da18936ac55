"""Comparison of label sets in local folders: the platform's part of `stone label-set compare`."""

import os
from pathlib import Path
from typing import Any

from services.eval.comparison.folders import compare_folders, open_folders, write_pictures
from stone_client.progress import Report


def compare(folders: tuple[Path, Path], pictures: Path | None, progress: Report) -> dict[str, Any]:
    """Return the record of the comparison, with the paths of the written images."""
    opened = open_folders(*folders)
    record = compare_folders(opened, progress)
    written = write_pictures(opened, record, pictures) if pictures else []
    return {**record, "pictures": [os.fspath(path) for path in written]}
