"""Totals of a label set for its database row: duration, distance, voxels by class."""

from services.labeler.results import load_pack
from services.labeler.run import LabelRun, parts_of
from services.labeler.tables import CLASS_COLUMNS, concatenated
from stone.splits.composition import duration_ns, path_length_m

Totals = dict[str, int | float]


def totals_of(run: LabelRun) -> Totals:
    """By the names of the row's columns; of packs that are in scratch."""
    counts = concatenated([load_pack(run, part)[1] for part in parts_of(run)])
    voxels = dict(zip(CLASS_COLUMNS, counts.classes.sum(axis=0).tolist(), strict=True))
    frames = run.sequence.frames
    distance_m = path_length_m(frames.map_from_ego.translation_m)
    return {"duration_ns": duration_ns(frames.stamps_ns), "distance_m": distance_m, **voxels}
