"""A sequence's labels from a server, in the folder layout that `stone label` writes.

**Conventions.** Every file is checked against the sha256 in its ETag; the folder appears whole or not at all.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from stone_base.errors import Refused
from stone_client.api import Api
from stone_client.files.fetch import save
from stone_client.progress import Report
from stone_client.server.sequences import Item
from stone_files.atomic import atomic_directory

MARK = "report.json"
FILES = {
    "report.json": "report",
    "bev.png": "previews/bev.png",
    "map.png": "previews/map.png",
    "features.png": "previews/features.png",
    "mesh.ply": "mesh",
    "frames.parquet": "frames.parquet",
    "grid.json": "grid.json",
    "sequence.npz": "sequence.npz",
}


def download_labels(api: Api, sequence: Item, output: Path, progress: Report) -> dict[str, Any]:
    """Write the files of the label set and the labels of every frame into `output`; return a record of them.

    Raises `no_labels`, `damaged_download`, `output_exists`, and what `Api.send` raises.
    """
    if sequence["labels"] is None:
        raise no_labels(sequence["name"])
    own = f"/sequences/{sequence['id']}"
    with atomic_directory(output, replaces=MARK) as folder:
        made = {artefact["name"] for artefact in sequence["artefacts"]}
        files = {name: route for name, route in FILES.items() if name in made}  # older sets have fewer
        for done, (name, route) in enumerate(files.items(), start=1):
            save(api, f"{own}/{route}", folder / name)
            progress("files", done, len(files))
        frames, total = 0, int(sequence["labels"]["frames"])
        for token in _tokens(api, own):
            target = folder / "gts" / sequence["name"] / token / "labels.npz"
            target.parent.mkdir(parents=True)
            save(api, f"/frames/{token}/labels.npz", target)
            frames += 1
            progress("frames", frames, total)
    return {"sequence": sequence["name"], "frames": frames, "output": str(output)}


def _tokens(api: Api, own: str) -> Iterator[str]:
    yield from (str(frame["token"]) for frame in api.pages(f"{own}/frames"))


def no_labels(name: str) -> Refused:
    return Refused("no_labels", f"sequence {name!r} has no labels yet; run `stone sequence process {name} --wait`")
