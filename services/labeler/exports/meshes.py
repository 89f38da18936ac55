"""The map's surface for other programs: PLY as it is, and binary glTF 2.0, coloured by class.

    <sequence>/mesh.ply   z up, the map frame        <sequence>/mesh.glb   y up, as glTF demands: (x, z, −y)

**Conventions.** The glTF is written from the mapped PLY part by part, so memory does not grow with the map: one part is
some 30 MB. One mesh, one primitive: positions float32, COLOR_0 normalised bytes RGBA, indices uint32.
Source: Khronos glTF 2.0, §3.4 (coordinate system), §3.6.2 (accessors), §4.4 (GLB).
"""

import json
import shutil
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from services.labeler.exports.errors import MeshTooLargeError
from services.labeler.exports.ply_file import MeshFile, open_mesh
from services.labeler.exports.source import LabelledSequence
from services.labeler.map.ply import VERTEX_RGB
from services.labeler.run import Step

ROWS_AT_ONCE = 1 << 20
MAGIC, VERSION, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 2, 0x4E4F534A, 0x004E4942
MOST_BYTES = 2**32 - 1
FLOAT, UNSIGNED_BYTE, UNSIGNED_INT, ARRAY_BUFFER, ELEMENT_BUFFER = 5126, 5121, 5125, 34962, 34963
POSITION_BYTES, COLOUR_BYTES, TRIANGLE_BYTES = 12, 4, 12


def write_meshes(source: LabelledSequence, out: Path, step: Step) -> None:
    """Write both into the empty folder `out`. Raises `DamagedLabelsError`, `MeshTooLargeError`."""
    mesh, folder = open_mesh(source.mesh), out / source.sequence.name
    folder.mkdir()
    shutil.copyfile(source.mesh, folder / "mesh.ply")
    step(1, 2)
    with (folder / "mesh.glb").open("wb") as file:
        write_glb(file, mesh)
    step(2, 2)


def write_glb(file: IO[bytes], mesh: MeshFile) -> None:
    """Raises `MeshTooLargeError` beyond the 4 GiB that the format can say."""
    vertices, triangles = (len(mesh.vertices), len(mesh.faces)) if len(mesh.faces) else (0, 0)
    lengths = (vertices * POSITION_BYTES, vertices * COLOUR_BYTES, triangles * TRIANGLE_BYTES)
    document = json.dumps(_document(mesh, lengths), separators=(",", ":")).encode()
    document += b" " * (-len(document) % 4)
    total = 12 + 8 + len(document) + (8 + sum(lengths) if sum(lengths) else 0)
    if total > MOST_BYTES:
        raise MeshTooLargeError(total, MOST_BYTES)
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
    """The JSON chunk; a map without surface is an empty scene, for glTF has no empty accessors."""
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
    """Least and greatest of each coordinate, y up."""
    parts = (_y_up(mesh.vertices["xyz"][rows]) for rows in _parts(len(mesh.vertices)))
    corners = np.array([[part.min(axis=0), part.max(axis=0)] for part in parts])
    return corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)


def _y_up(xyz: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.stack([xyz[:, 0], xyz[:, 2], -xyz[:, 1]], axis=1).astype("<f4")


def _parts(count: int) -> Iterator[slice]:
    return (slice(begin, begin + ROWS_AT_ONCE) for begin in range(0, count, ROWS_AT_ONCE))
