"""The whole labelled map as pictures, mesh and scene, tile by tile, so that memory holds one tile at a time."""

from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from services.labeler.frames import labelled_tile
from services.labeler.map.comparison import ComparisonCounter, save_comparison
from services.labeler.map.ply import Piece, class_at, write_mesh
from services.labeler.map.scene_files import SceneFiles
from services.labeler.map.surface import TileSummary
from services.labeler.map.track_coverage import CoverageCounter, save_coverage
from services.labeler.previews.map_picture import TopView, write_top_view
from services.labeler.previews.map_pieces import MapPiece
from services.labeler.previews.thumbnail import write_thumbnail
from services.labeler.results import load_reference, load_summaries
from services.labeler.run import LabelRun, Step, Tile
from services.labeler.scratch import whole
from services.labeler.stage import Arguments, StageResult
from stone.labels.traversability import Reference

MAP, TOP_VIEW, THUMBNAIL, MESH = "map", "bev.png", "thumbnail.png", "mesh.ply"


def draw_map(run: LabelRun, _arguments: Arguments, step: Step) -> StageResult:
    """Make the map's top view, mesh and scene in the folder `map` of scratch."""
    write_map(run, load_summaries(run), load_reference(run), map_folder(run), step)
    return StageResult()


def draw_pictures(run: LabelRun, _arguments: Arguments, step: Step) -> StageResult:
    """Make the map's pictures in perspective and of its features, in the same folder."""
    step(0, 1)
    from services.labeler.previews.preview_files import (
        write_map_previews,  # imports plotting and film libraries: half a second
    )

    reference = load_reference(run)
    pieces = [partial(_map_piece, run, summary.tile, reference) for summary in load_summaries(run)]
    write_map_previews(pieces, run.sequence.frames.map_from_ego, map_folder(run), run.parameters.profile)
    return StageResult()


def map_folder(run: LabelRun) -> Path:
    """Return the folder whose files are published under their names."""
    return run.scratch / MAP


def write_map(run: LabelRun, tiles: list[TileSummary], reference: Reference, out: Path, step: Step) -> None:
    """Write `bev.png`, `thumbnail.png`, `mesh.ply` and the viewer's scene into the folder `out`, tile by tile.

    Saves the comparison of the profiles and the T coverage of the track in scratch.
    """
    view, counter, scene = TopView({}), ComparisonCounter(run, tiles), SceneFiles(run, reference, out)
    driven = CoverageCounter(run)
    for number, summary in enumerate(tiles):
        step(number, len(tiles) + 1)
        labelled = labelled_tile(run, summary.tile, reference, with_confidence=True)
        view.add(summary.tile, labelled.terrain.keys, labelled.classes)  # type: ignore[arg-type]
        counter.add(labelled)
        driven.add(summary.tile, labelled)
        scene.add(summary.tile, labelled)
    scene.finish()
    save_comparison(run, counter.comparison)
    save_coverage(run, driven.coverage())
    with whole(out / TOP_VIEW) as staging:
        write_top_view(staging, view, run.sequence.frames.map_from_ego)
    with whole(out / THUMBNAIL) as staging:
        write_thumbnail(staging, view, run.sequence.frames.map_from_ego)
    step(len(tiles), len(tiles) + 1)
    totals = (sum(tile.vertices for tile in tiles), sum(tile.triangles for tile in tiles))
    with whole(out / MESH) as staging:
        write_mesh(staging, totals, [partial(_piece, run, tile.tile, reference) for tile in tiles])
    step(len(tiles) + 1, len(tiles) + 1)


def _piece(run: LabelRun, tile: Tile, reference: Reference) -> Piece:
    labelled = labelled_tile(run, tile, reference)
    mesh = labelled.mesh
    vertices: NDArray[np.float32] = mesh["vertices"]  # type: ignore[assignment]
    kinds = class_at(vertices, labelled.terrain.keys, labelled.classes)
    return vertices, mesh["vertex_features"], mesh["triangles"], kinds  # type: ignore[return-value]


def _map_piece(run: LabelRun, tile: Tile, reference: Reference) -> MapPiece:
    labelled = labelled_tile(run, tile, reference)
    return MapPiece(labelled.terrain.keys, labelled.terrain.features(run.parameters.rule), labelled.classes)
