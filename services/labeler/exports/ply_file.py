"""The map's `mesh.ply` read back as arrays that stay on disk until they are looked at.

**Conventions.** As `services/labeler/map/ply.py` writes it: vertices with colours of their class, triangles.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from services.labeler.exports.errors import DamagedLabelsError
from services.labeler.map.ply import FACE, HEADER, VERTEX
from stone.labels.class_colours import CLASS_RGB

MOST_HEADER_BYTES = 4096


@dataclass(frozen=True, eq=False)
class MeshFile:
    """`vertices` (V,) records xyz, rgb; `faces` (F,) records n = 3 and indices."""

    vertices: NDArray[np.void]
    faces: NDArray[np.void]

    def classes(self, rows: slice) -> NDArray[np.uint8]:
        """The class of each of these vertices, 0 where it has none."""
        rgb = self.vertices["rgb"][rows]
        classes = np.zeros(len(rgb), np.uint8)
        for kind, colour in CLASS_RGB.items():
            classes[(rgb == np.array(colour, np.uint8)).all(axis=1)] = kind
        return classes


def open_mesh(path: Path) -> MeshFile:
    """Raises `DamagedLabelsError` where the file is not one of ours."""
    try:
        with path.open("rb") as file:
            head = file.read(MOST_HEADER_BYTES).partition(b"end_header\n")[0].decode("ascii", "replace")
        counts = [int(line.split()[2]) for line in head.splitlines() if line.startswith("element ")]
        header = HEADER.format(vertices=counts[0], triangles=counts[1]).encode()
    except (OSError, ValueError, IndexError) as error:
        raise DamagedLabelsError(path, str(error) or "it is no mesh of ours") from error
    expected = len(header) + counts[0] * VERTEX.itemsize + counts[1] * FACE.itemsize
    if not head.encode().startswith(header[: len(head)]) or path.stat().st_size != expected:
        raise DamagedLabelsError(path, f"its header promises {expected} bytes")
    return MeshFile(
        _mapped(path, VERTEX, len(header), counts[0]),
        _mapped(path, FACE, len(header) + counts[0] * VERTEX.itemsize, counts[1]),
    )


def _mapped(path: Path, record: np.dtype[np.void], offset: int, count: int) -> NDArray[np.void]:
    if count == 0:
        return np.zeros(0, record)
    return np.memmap(path, record, "r", offset, (count,))
