"""The map's `mesh.ply` read back as arrays that stay on disk until they are looked at.

**Conventions.** As `services/labeler/map/ply.py` writes it: vertices with colours of their class, triangles. Meshes of
earlier label sets have the colours of an earlier palette and another comment in their header: they are read alike.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from services.labeler.exports.errors import DamagedLabelsError
from services.labeler.map.ply import FACE, VERTEX, header_of
from stone.labels.class_colours import PALETTES

MOST_HEADER_BYTES = 4096
END = b"end_header\n"


@dataclass(frozen=True, eq=False)
class MeshFile:
    """`vertices` (V,) records xyz, rgb; `faces` (F,) records n = 3 and indices."""

    vertices: NDArray[np.void]
    faces: NDArray[np.void]

    def classes(self, rows: slice | NDArray[np.int64]) -> NDArray[np.uint8]:
        """The class of each of these vertices, 0 where it has none."""
        rgb = self.vertices["rgb"][rows]
        classes = np.zeros(len(rgb), np.uint8)
        for palette in PALETTES.values():
            for kind, colour in palette.items():
                classes[(rgb == np.array(colour, np.uint8)).all(axis=1)] = kind
        return classes


def open_mesh(path: Path) -> MeshFile:
    """Raises `DamagedLabelsError` where the file is not one of ours."""
    try:
        with path.open("rb") as file:
            written = file.read(MOST_HEADER_BYTES).partition(END)[0]
        head = written.decode("ascii", "replace")
        counts = [int(line.split()[2]) for line in head.splitlines() if line.startswith("element ")]
        header = header_of(counts[0], counts[1])
    except (OSError, ValueError, IndexError) as error:
        raise DamagedLabelsError(path, str(error) or "it is no mesh of ours") from error
    start = len(written) + len(END)
    expected = start + counts[0] * VERTEX.itemsize + counts[1] * FACE.itemsize
    if _facts(head) != _facts(header.removesuffix(END).decode()) or path.stat().st_size != expected:
        raise DamagedLabelsError(path, f"its header promises {expected} bytes")
    return MeshFile(
        _mapped(path, VERTEX, start, counts[0]),
        _mapped(path, FACE, start + counts[0] * VERTEX.itemsize, counts[1]),
    )


def _facts(head: str) -> list[str]:
    """The lines of a header that say how the file is laid out."""
    return [line for line in head.split("\n") if not line.startswith("comment ")]


def _mapped(path: Path, record: np.dtype[np.void], offset: int, count: int) -> NDArray[np.void]:
    if count == 0:
        return np.zeros(0, record)
    return np.memmap(path, record, "r", offset, (count,))
