"""A sequence's labels from a server, in the folder layout that `stone label` writes.

**Conventions.** Every file is checked against the sha256 in its ETag; the folder appears whole or not at all.
"""

from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path
from typing import Any

import httpx

from client.api import BUSY, Api, Patience
from client.errors import DamagedDownloadError, NoLabelsError, ServerRefusedError, ServerUnreachableError
from client.progress import Report
from client.remote import Item
from services.runtime.atomic import atomic_directory

MARK = "report.json"
PATIENCE_S = 60.0
IDENTITY = {"Accept-Encoding": "identity"}
FILES = {
    "report.json": "report",
    "bev.png": "previews/bev.png",
    "mesh.ply": "mesh",
    "frames.parquet": "frames.parquet",
}


def download_labels(api: Api, sequence: Item, output: Path, progress: Report) -> dict[str, Any]:
    """Fill `output` with report, picture, mesh, frame table and one `labels.npz` a frame; what came.

    Raises `NoLabelsError`, `DamagedDownloadError`, `OutputExistsError`, and what `Api.send` raises.
    """
    if sequence["labels"] is None:
        raise NoLabelsError(sequence["name"])
    own = f"/sequences/{sequence['id']}"
    with atomic_directory(output, replaces=MARK) as folder:
        for done, (name, route) in enumerate(FILES.items(), start=1):
            save(api, f"{own}/{route}", folder / name)
            progress("files", done, len(FILES))
        frames, total = 0, int(sequence["labels"]["frames"])
        for token in _tokens(api, own):
            target = folder / "gts" / sequence["name"] / token / "labels.npz"
            target.parent.mkdir(parents=True)
            save(api, f"/frames/{token}/labels.npz", target)
            frames += 1
            progress("frames", frames, total)
    return {"sequence": sequence["name"], "frames": frames, "output": str(output)}


def save(api: Api, path: str, target: Path) -> None:
    """Fetch one file, anew after a broken connection or when the server is busy.

    Raises `DamagedDownloadError`, `ServerUnreachableError`, `ServerRefusedError`.
    """
    patience = Patience(PATIENCE_S)
    while True:
        try:
            return _fetch(api, path, target)
        except httpx.TransportError as error:
            if not patience.wait(None):
                raise ServerUnreachableError(api.url, str(error) or type(error).__name__) from None
        except ServerRefusedError as error:
            if error.status not in BUSY or not patience.wait(error.retry_after_s):
                raise


def _fetch(api: Api, path: str, target: Path) -> None:
    found = sha256()
    with api.stream(path, IDENTITY) as answer, target.open("wb") as file:
        for piece in answer.iter_bytes():
            found.update(piece)
            file.write(piece)
    promised = answer.headers.get("ETag", "").strip('"')
    if found.hexdigest() != promised:
        raise DamagedDownloadError(path, found.hexdigest(), promised)


def _tokens(api: Api, own: str) -> Iterator[str]:
    yield from (str(frame["token"]) for frame in api.pages(f"{own}/frames"))
