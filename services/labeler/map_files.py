"""The whole labelled map as pictures, mesh and scene, tile by tile, so that memory holds one tile at a time."""

from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from services.labeler.comparison import Tally, save_comparison
from services.labeler.frames import labelled_tile
from services.labeler.picture import TopView, write_top_view
from services.labeler.ply import Piece, class_at, write_mesh
from services.labeler.previews.map_pieces import MapPiece
from services.labeler.run import Run, Step, Tile, silent
from services.labeler.scene_files import SceneFiles
from services.labeler.scratch import whole
from services.labeler.surface import TileSummary
from services.labeler.thumbnail import write_thumbnail
from stone.traversability import Reference

TOP_VIEW, THUMBNAIL, MESH = "bev.png", "thumbnail.jpg", "mesh.ply"


def write_map(run: Run, tiles: list[TileSummary], reference: Reference, out: Path, step: Step = silent) -> None:
    """Write `bev.png`, `thumbnail.jpg`, `mesh.ply`, the map's previews and the viewer's scene into the folder `out`, in
    the order of the tiles, and leave in scratch how the profiles compare."""
    view, tally, scene = TopView({}), Tally(run, tiles), SceneFiles(run, reference, out)
    for number, summary in enumerate(tiles):
        step(number, len(tiles) + 2)
        arrays, classes = labelled_tile(run, summary.tile, reference)
        view.add(summary.tile, arrays["keys"], classes)  # type: ignore[arg-type]
        tally.add(arrays, classes)
        scene.add(summary.tile, arrays, classes)
    scene.finish()
    save_comparison(run, tally.comparison)
    with whole(out / TOP_VIEW) as staging:
        write_top_view(staging, view, run.sequence.frames.map_from_ego)
    with whole(out / THUMBNAIL) as staging:
        write_thumbnail(staging, view, run.sequence.frames.map_from_ego)
    step(len(tiles), len(tiles) + 2)
    totals = (sum(tile.vertices for tile in tiles), sum(tile.triangles for tile in tiles))
    with whole(out / MESH) as staging:
        write_mesh(staging, totals, [partial(_piece, run, tile.tile, reference) for tile in tiles])
    step(len(tiles) + 1, len(tiles) + 2)
    from services.labeler.previews.writing import write_map_previews  # it plots and films: half a second of imports

    pieces = [partial(_map_piece, run, tile.tile, reference) for tile in tiles]
    write_map_previews(pieces, run.sequence.frames.map_from_ego, out, run.parameters.profile)
    step(len(tiles) + 2, len(tiles) + 2)


def _piece(run: Run, tile: Tile, reference: Reference) -> Piece:
    arrays, classes = labelled_tile(run, tile, reference)
    vertices: NDArray[np.float32] = arrays["vertices"]  # type: ignore[assignment]
    return vertices, arrays["triangles"], class_at(vertices, arrays["keys"], classes)  # type: ignore[return-value,arg-type]


def _map_piece(run: Run, tile: Tile, reference: Reference) -> MapPiece:
    arrays, classes = labelled_tile(run, tile, reference)
    return MapPiece(arrays["keys"], arrays["features"], classes)  # type: ignore[arg-type]
