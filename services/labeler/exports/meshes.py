"""The map's surface for other programs: PLY as it is, and binary glTF 2.0, coloured by class.

    <sequence>/mesh.ply   z up, the map frame        <sequence>/mesh.glb   y up, as glTF requires: (x, z, −y)

**Conventions.** The glTF is written part by part from the memory-mapped PLY, so memory does not grow with the map: one
part takes about 30 MB. One mesh, one primitive: positions float32, COLOR_0 normalised bytes RGBA, indices uint32.
Source: Khronos glTF 2.0, §3.4 (coordinate system), §3.6.2 (accessors), §4.4 (GLB).
"""

import json
import shutil
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from services.labeler.exports.errors import damaged_labels
from services.labeler.exports.source import LabelledSequence
from services.labeler.map.ply import BARE_VERTEX, FACE, FEATURES, VERTEX, VERTEX_RGB, header_of
from services.labeler.run import Step
from stone.errors import Refused
from stone.labels.class_colours import PALETTES

# The map's mesh in parts of bounded size.


MOST_TRIANGLES = 1 << 17


@dataclass(frozen=True, eq=False)
class MeshPart:
    """A part of the mesh: used `vertices_map` (V, 3), class colours `rgb` (V, 3), and `triangles` (T, 3)."""

    vertices_map: NDArray[np.float32]
    rgb: NDArray[np.uint8]
    triangles: NDArray[np.uint32]


def mesh_parts(path: Path, most_triangles: int = MOST_TRIANGLES) -> Iterator[MeshPart]:
    """Yield the mesh in the file's order; nothing for an empty mesh. Raises `damaged_labels`."""
    mesh = open_mesh(path)
    for begin in range(0, len(mesh.faces), most_triangles):
        corners = mesh.faces["indices"][begin : begin + most_triangles]
        rows, triangles = np.unique(corners, return_inverse=True)
        vertices = mesh.vertices[rows]
        yield MeshPart(
            np.ascontiguousarray(vertices["xyz"]),
            VERTEX_RGB[mesh.classes(rows)],
            triangles.reshape(-1, 3).astype(np.uint32),
        )


# Reads the map's `mesh.ply` (`services/labeler/map/ply.py`) as memory-mapped arrays. Meshes of earlier label sets lack
# features, or have an earlier palette and another comment in the header; they are read in the same way.


MOST_HEADER_BYTES = 4096
END = b"end_header\n"


@dataclass(frozen=True, eq=False)
class MeshFile:
    """`vertices` (V,) records of xyz, rgb and usually features; `faces` (F,) records of n = 3 and indices."""

    vertices: NDArray[np.void]
    faces: NDArray[np.void]

    def classes(self, rows: slice | NDArray[np.int64]) -> NDArray[np.uint8]:
        """Return the class of each of these vertices, 0 for none."""
        rgb = self.vertices["rgb"][rows]
        classes = np.zeros(len(rgb), np.uint8)
        for palette in PALETTES.values():
            for kind, colour in palette.items():
                classes[(rgb == np.array(colour, np.uint8)).all(axis=1)] = kind
        return classes


def open_mesh(path: Path) -> MeshFile:
    """Return the mesh. Raises `damaged_labels` if the platform did not write the file."""
    try:
        with path.open("rb") as file:
            written = file.read(MOST_HEADER_BYTES).partition(END)[0]
        head = written.decode("ascii", "replace")
        counts = [int(line.split()[2]) for line in head.splitlines() if line.startswith("element ")]
        record = VERTEX if FEATURES in head else BARE_VERTEX
        header = header_of(counts[0], counts[1], has_features=record is VERTEX)
    except (OSError, ValueError, IndexError) as error:
        raise damaged_labels(path, str(error) or "it is not a mesh written by STONE") from error
    start = len(written) + len(END)
    faces_at = start + counts[0] * record.itemsize
    expected = faces_at + counts[1] * FACE.itemsize
    if _facts(head) != _facts(header.removesuffix(END).decode()) or path.stat().st_size != expected:
        raise damaged_labels(path, f"its header requires {expected} bytes")
    return MeshFile(_map_file(path, record, start, counts[0]), _map_file(path, FACE, faces_at, counts[1]))


def _facts(head: str) -> list[str]:
    """Return the header lines that describe the file's layout."""
    return [line for line in head.split("\n") if not line.startswith("comment ")]


def _map_file(path: Path, record: np.dtype[np.void], offset: int, count: int) -> NDArray[np.void]:
    if count == 0:
        return np.zeros(0, record)
    return np.memmap(path, record, "r", offset, (count,))


ROWS_AT_ONCE = 1 << 20
MAGIC, VERSION, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 2, 0x4E4F534A, 0x004E4942
MOST_BYTES = 2**32 - 1
FLOAT, UNSIGNED_BYTE, UNSIGNED_INT, ARRAY_BUFFER, ELEMENT_BUFFER = 5126, 5121, 5125, 34962, 34963
POSITION_BYTES, COLOUR_BYTES, TRIANGLE_BYTES = 12, 4, 12


def write_meshes(source: LabelledSequence, out: Path, step: Step) -> None:
    """Write the PLY and the glTF into the empty folder `out`. Raises `damaged_labels`, `mesh_too_large`."""
    mesh, folder = open_mesh(source.mesh), out / source.sequence.name
    folder.mkdir()
    shutil.copyfile(source.mesh, folder / "mesh.ply")
    step(1, 2)
    with (folder / "mesh.glb").open("wb") as file:
        write_glb(file, mesh)
    step(2, 2)


def write_glb(file: IO[bytes], mesh: MeshFile) -> None:
    """Write the glTF. Raises `mesh_too_large` beyond the format's limit of 4 GiB."""
    vertices, triangles = (len(mesh.vertices), len(mesh.faces)) if len(mesh.faces) else (0, 0)
    lengths = (vertices * POSITION_BYTES, vertices * COLOUR_BYTES, triangles * TRIANGLE_BYTES)
    document = json.dumps(_document(mesh, lengths), separators=(",", ":")).encode()
    document += b" " * (-len(document) % 4)
    total = 12 + 8 + len(document) + (8 + sum(lengths) if sum(lengths) else 0)
    if total > MOST_BYTES:
        raise Refused(
            "mesh_too_large",
            f"the mesh needs {total} bytes as binary glTF, but the format allows at most {MOST_BYTES}; use the PLY",
        )
    file.write(struct.pack("<3I", MAGIC, VERSION, total))
    file.write(struct.pack("<2I", len(document), JSON_CHUNK) + document)
    if sum(lengths):
        file.write(struct.pack("<2I", sum(lengths), BINARY_CHUNK))
    for rows in _parts(vertices):
        file.write(_y_up(mesh.vertices["xyz"][rows]).tobytes())
    for rows in _parts(vertices):
        opaque = np.full((len(mesh.vertices[rows]), 4), 255, np.uint8)
        opaque[:, :3] = VERTEX_RGB[mesh.classes(rows)]
        file.write(opaque.tobytes())
    for rows in _parts(triangles):
        file.write(mesh.faces["indices"][rows].astype("<u4").tobytes())


def _document(mesh: MeshFile, lengths: tuple[int, int, int]) -> dict[str, Any]:
    """Return the JSON chunk; a map without surface is an empty scene, since glTF has no empty accessors."""
    document: dict[str, Any] = {"asset": {"version": "2.0", "generator": "STONE platform"}, "scene": 0}
    if not len(mesh.faces):
        return document | {"scenes": [{}]}
    low, high = _bounds(mesh)
    primitive = {"attributes": {"POSITION": 0, "COLOR_0": 1}, "indices": 2, "material": 0}
    starts = (0, lengths[0], lengths[0] + lengths[1])
    targets = (ARRAY_BUFFER, ARRAY_BUFFER, ELEMENT_BUFFER)
    views = zip(starts, lengths, targets, strict=True)
    return document | {
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "terrain", "mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "materials": [{"pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 1}, "doubleSided": True}],
        "buffers": [{"byteLength": sum(lengths)}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": start, "byteLength": length, "target": target}
            for start, length, target in views
        ],
        "accessors": [
            _accessor(0, FLOAT, len(mesh.vertices), "VEC3") | {"min": low.tolist(), "max": high.tolist()},
            _accessor(1, UNSIGNED_BYTE, len(mesh.vertices), "VEC4") | {"normalized": True},
            _accessor(2, UNSIGNED_INT, 3 * len(mesh.faces), "SCALAR"),
        ],
    }


def _accessor(view: int, component: int, count: int, kind: str) -> dict[str, Any]:
    return {"bufferView": view, "componentType": component, "count": count, "type": kind}


def _bounds(mesh: MeshFile) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the minimum and maximum of each coordinate, y up."""
    parts = (_y_up(mesh.vertices["xyz"][rows]) for rows in _parts(len(mesh.vertices)))
    corners = np.array([[part.min(axis=0), part.max(axis=0)] for part in parts])
    return corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)


def _y_up(xyz: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.stack([xyz[:, 0], xyz[:, 2], -xyz[:, 1]], axis=1).astype("<f4")


def _parts(count: int) -> Iterator[slice]:
    return (slice(begin, begin + ROWS_AT_ONCE) for begin in range(0, count, ROWS_AT_ONCE))
