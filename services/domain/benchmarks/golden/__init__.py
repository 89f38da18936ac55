"""Golden vectors of the metrics: a small ground truth, a submission to it, and the expected scores.

**Conventions.** The files are `gts/<sequence>/<frame_token>/labels.npz`, `manifest.json` and `submission.zip`.
`expected.json` contains, for each mask, the counts of each frame and the ratios of the whole and of each sequence, null
if undefined. `refused.zip` must be refused with the code in its name. The expectations come from a slow metric that
shares no code with the platform (`tests/golden_vectors.py`). The vectors are public, so that other implementations can
be tested against them.
"""

import io
import zipfile
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable

EPOCH = (1980, 1, 1, 0, 0, 0)


@cache
def golden_names() -> tuple[str, ...]:
    """Return the names of the files with forward slashes, sorted."""
    return tuple(sorted(_names(files(__package__), "")))


def golden_file(name: str) -> bytes:
    """Return the content of one of `golden_names`. Raises `KeyError` for any other name."""
    if name not in golden_names():
        raise KeyError(name)
    return files(__package__).joinpath(*name.split("/")).read_bytes()


@cache
def golden_archive() -> bytes:
    """Return all files as one zip with reproducible bytes."""
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w") as archive:
        for name in golden_names():
            archive.writestr(zipfile.ZipInfo(name, EPOCH), golden_file(name))
    return whole.getvalue()


def _names(folder: Traversable, prefix: str) -> list[str]:
    names = []
    for entry in folder.iterdir():
        if entry.is_dir() and entry.name != "__pycache__":
            names += _names(entry, f"{prefix}{entry.name}/")
        elif entry.is_file() and not entry.name.endswith((".py", ".pyc")):
            names.append(f"{prefix}{entry.name}")
    return names
