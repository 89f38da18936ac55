"""The work of a sandboxed child that imports one scene of an indexed dataset.

    spans in the archive → files checked and copied → labels checked and copied, their map fused → products, report,
    totals

**Conventions.** All results are written to the scene's folder `out` under the names of artefacts. Intermediate files
are in a separate folder, which is deleted.
"""

import json
import shutil
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from services.domain.sequences.label_sources import SOURCE, SOURCE_INDEX, SOURCE_PLACED
from services.domain.sequences.run_files import SEQUENCE_FILE
from services.labeler.child_answers import PackAnswer, PublicationAnswer, Range, TotalsAnswer
from services.labeler.exports.dataset_source import PlacedFiles, placed_bytes
from services.labeler.exports.nuscenes.tables import VERSION
from services.labeler.exports.source import REPORT, TABLE
from services.labeler.frames import GRIDS, FrameVoxelCounts
from services.labeler.imports.fused_labels import FusedLabels, VoteBricks
from services.labeler.imports.label_counts import class_counts, set_count
from services.labeler.imports.map_products import PROFILE, MapFacts, write_map_products
from services.labeler.imports.scene_parts import (
    OUT,
    TABLES,
    SceneOpening,
    SceneParts,
    read_scene_parts,
    scene_damaged,
    scene_folder,
)
from services.labeler.report import CLASS_NAMES
from services.labeler.tables import CLASS_COLUMNS, write_frames
from services.labeler.totals import track_of
from services.runtime.code_version import code_version
from services.runtime.sandbox import ProgressCallback
from services.runtime.store.packs import PackWriter, index_bytes, pieces_of
from stone.findings import Finding
from stone.geometry.se3 import SE3
from stone.labels.grid import Grid
from stone.splits.composition import duration_ns, path_length_m
from stone.splits.drives import TrackOrigin
from stone_base.label_grid import record_unless_paper
from stone_datasets.classes import MEANINGS, OWN_CLASSES, ClassMap
from stone_datasets.drives import origin_of
from stone_datasets.faults import DatasetPlace
from stone_datasets.labels import FrameLabels, read_labels
from stone_datasets.samples import check_sample
from stone_exports.files import ExportFileSpan
from stone_exports.frames import LIDAR_CHANNEL, ExportedSensor
from stone_files.archives import check_names
from stone_files.dataset_layout import ANNOTATIONS
from stone_files.npz import npz_bytes

# The source of an imported label set: the published files of its scene, in packs: source/index.npz, source/000000.pack
# …, source/placed.npz. The index is a `PackedFiles` in the order of names: `v1.0-trainval/<table>.json`,
# `v1.0-trainval/splits.json`, `samples/…`, `sweeps/…`, `maps/…`; and `gts/…` if the dataset's labels have other keys or
# no masks, so that an export can restore them. Bytes are the dataset's; sensor files are checked before they are
# copied. From an archive in place only tables are copied: `placed.npz` has the offsets of the other files, which are
# checked when they are read.


Told = Callable[[int, int], None]


def write_source(parts: SceneParts, out: Path, progress: Told, *, is_in_place: bool) -> None:
    """Write the indexes and packs to `out`. Raises a `DatasetFaultError`, `bad_member`, `StoreFullError`."""
    tables = {f"{VERSION}/{path.name}": path for path in (parts.folder / TABLES).iterdir()}
    places = {name: number for number, name in enumerate(parts.spans.names)}
    is_own = parts.layout.has_masks and parts.layout.label_key == GRIDS[0]
    labels = {} if is_own else {file.name: file for file in map(parts.label_file, range(len(parts.spans.labels)))}
    names = sorted({*tables, *places, *labels})
    check_names(names)
    sensors, packed = sensors_of(parts), PackWriter(out / SOURCE)
    if is_in_place:
        (out / SOURCE_PLACED).write_bytes(placed_bytes(_place_files(parts, [*labels])))
        names = sorted(tables)
    for done, name in enumerate(names):
        progress(done, len(names))
        if name in tables:
            packed.add(name, pieces_of(tables[name]))
        elif name in labels:
            packed.add(name, labels[name].pieces())
        else:
            packed.add(name, _check_file(parts, places[name], sensors).pieces())
    (out / SOURCE_INDEX).write_bytes(index_bytes(packed.files()))


def _place_files(parts: SceneParts, labels: list[str]) -> PlacedFiles:
    """Return the offsets of the scene's files, and of the label files with these names, in the archive."""
    spans, held = parts.spans, [f"{parts.about.root}{name}" for name in labels]
    places = np.concatenate([spans.places, spans.labels[: len(labels)]])
    return PlacedFiles((*spans.names, *labels), (*spans.held, *held), places)


def sensors_of(parts: SceneParts) -> dict[str, ExportedSensor]:
    """Return the sensors of the scene by channel, with which its files are checked."""
    calibration = parts.sequence.calibration
    lidar = ExportedSensor(LIDAR_CHANNEL, "lidar", calibration.ego_from_lidar, None)
    return {LIDAR_CHANNEL: lidar} | {
        mount.name: ExportedSensor(mount.name, mount.kind, mount.lidar_from_sensor, mount.intrinsics)
        for mount in calibration.mounts
    }


def _check_file(parts: SceneParts, number: int, sensors: dict[str, ExportedSensor]) -> ExportFileSpan:
    """Return the span of a file after checking that it fits its sensor; maps are not checked."""
    span, channel, row = parts.file(number), parts.spans.channels[number], int(parts.spans.rows[number])
    if not channel:
        return span
    if channel not in sensors:
        raise scene_damaged(f"{span.name} belongs to {channel!r}, which is not in the rig")
    row_place = (
        DatasetPlace(ANNOTATIONS) if row < 0 else DatasetPlace(f"{parts.about.version}/sample_data.json", row + 1)
    )
    check_sample(span, sensors[channel], row_place, has_no_returns=parts.layout.has_no_returns)
    return span


# The labels of a scene's frames: read, checked, counted, packed, and passed to the map. Files that already have the
# platform's form are copied; others are written in the labeler's form. A mask that the dataset lacks is 1 everywhere,
# since no voxel is known to be unobserved.


LABELS, PACKS = "labels", "packs"
FRAMES_A_PACK = 4096


@dataclass(eq=False)
class ImportedLabels:
    """The labels written so far, frame by frame: ranges of packs, voxels by class (n, 4), observed (n, 2).

    `notes` counts rewritten files and missing masks.
    """

    ranges: list[Range] = field(default_factory=list)
    classes: list[list[int]] = field(default_factory=list)
    observed: list[list[int]] = field(default_factory=list)
    notes: Counter[str] = field(default_factory=Counter)

    def counts(self) -> FrameVoxelCounts:
        filled = np.zeros(len(self.classes), np.int64)
        return FrameVoxelCounts(np.array(self.classes, np.int64), np.array(self.observed, np.int64), filled)

    def packs(self) -> list[PackAnswer]:
        """Return the packs, named after their first frames."""
        firsts = range(0, len(self.ranges), FRAMES_A_PACK)
        return [
            PackAnswer(name=f"{PACKS}/{first:06d}.pack", first=first, ranges=self.ranges[first : first + FRAMES_A_PACK])
            for first in firsts
        ]


def copied_labels(parts: SceneParts, classes: ClassMap, out: Path, into: ImportedLabels) -> Iterator[Grid]:
    """Yield the classes of each frame, once its labels are in the packs of the folder `out`.

    Raises a `DatasetFaultError`.
    """
    (out / LABELS).mkdir(parents=True)
    classes = OWN_CLASSES if np.array_equal(classes.meaning, OWN_CLASSES.meaning) else classes
    for frame in range(len(parts.spans.labels)):
        labels = read_labels(parts.label_file(frame), classes, parts.layout)
        path = out / LABELS / f"{frame // FRAMES_A_PACK * FRAMES_A_PACK:06d}.pack"
        _add(labels, path, into)
        yield labels.classes


def _add(labels: FrameLabels, path: Path, into: ImportedLabels) -> None:
    masks = {"mask_lidar": labels.mask_lidar, "mask_camera": labels.mask_camera}
    grids = [np.ones_like(labels.classes) if mask is None else mask for mask in masks.values()]
    payload = labels.content
    if payload is None:
        payload = npz_bytes(dict(zip(GRIDS, (labels.classes, *grids), strict=True)))
        into.notes["rewritten"] += 1
    into.notes.update(name for name, mask in masks.items() if mask is None)
    with path.open("ab") as pack:
        into.ranges.append((pack.tell(), len(payload), sha256(payload).hexdigest()))
        pack.write(payload)
    into.classes.append(class_counts(labels.classes))
    into.observed.append([set_count(grid) for grid in grids])


SCRATCH = "scratch"


def import_scene(opening: SceneOpening, folder: Path, progress: ProgressCallback) -> bytes:
    """Write the artefacts of the scene to `scenes/<ordinal>/out`; return a `PublicationAnswer`.

    Raises the first `DatasetFaultError`, `scene_damaged`, `bad_member`, `StoreFullError`.
    """
    scene = folder / scene_folder(opening.ordinal)
    parts, out = read_scene_parts(scene, opening.dataset), scene / OUT
    for made in (out, scene / SCRATCH):
        shutil.rmtree(made, ignore_errors=True)
        made.mkdir()
    write_source(parts, out, lambda done, total: progress("copy", done, total), is_in_place=opening.is_in_place)
    labels = _labels(parts, opening, progress)
    shutil.copyfile(scene / SEQUENCE_FILE, out / SEQUENCE_FILE)
    write_frames(out / TABLE, parts.sequence, labels.counts())
    shutil.rmtree(scene / SCRATCH)
    return _answer(parts, labels).packed()


def _labels(parts: SceneParts, opening: SceneOpening, progress: ProgressCallback) -> ImportedLabels:
    """Write the labels in packs and their products."""
    sequence, out, labels = parts.sequence, parts.folder / OUT, ImportedLabels()
    scratch = parts.folder / SCRATCH
    fused, poses = (
        FusedLabels(sequence.name, scratch / "votes", VoteBricks(grid=parts.layout.grid)),
        sequence.frames.map_from_ego,
    )
    for frame, classes in enumerate(copied_labels(parts, opening.classes, out, labels)):
        fused.add(classes, poses[frame])
        progress("labels", frame + 1, len(poses))
    mapped = write_map_products(fused, sequence, (out, scratch), lambda done, total: progress("map", done, total))
    (out / REPORT).write_text(report_text(parts, opening.classes, labels, mapped))
    return labels


def _answer(parts: SceneParts, labels: ImportedLabels) -> PublicationAnswer:
    frames = parts.sequence.frames
    return PublicationAnswer(
        tokens=list(frames.tokens),
        stamps_ns=frames.stamps_ns.tolist(),
        packs=labels.packs(),
        grid=record_unless_paper(parts.layout.grid),
        totals=TotalsAnswer(
            duration_ns=duration_ns(frames.stamps_ns),
            distance_m=path_length_m(frames.map_from_ego.translation_m),
            track=track_of(parts.sequence, _origin_of(parts), SE3.identity()),
            **voxel_totals(labels.counts()),  # type: ignore[arg-type]
        ),
    )


def _origin_of(parts: SceneParts) -> TrackOrigin:
    """Return the origin from the scene's log."""
    (log, *_) = json.loads((parts.folder / TABLES / "log.json").read_bytes()) or [{}]
    logfile, vehicle, location = (str(log.get(key, "")) for key in ("logfile", "vehicle", "location"))
    return origin_of((logfile, vehicle, location), parts.sequence.name)


def voxel_totals(counts: FrameVoxelCounts) -> Mapping[str, int]:
    """Return the voxels of all frames by class, by column name."""
    return dict(zip(CLASS_COLUMNS, counts.classes.sum(axis=0).tolist(), strict=True))


# `report.json` of an imported label set: its source, the meaning of its classes, and missing data. Keys shared with the
# labeler's own report (`services/labeler/report.py`) have the same meaning; facts known only after labelling are null.


NO_MASK = {
    "mask_lidar": "it is unknown which voxels a ray reached, so free voxels may be unobserved",
    "mask_camera": "it is unknown which voxels a camera sees, so scores within the cameras' view count all voxels",
}


def report_text(parts: SceneParts, classes: ClassMap, labels: ImportedLabels, mapped: MapFacts) -> str:
    """Return the file's content."""
    counts, sequence = labels.counts(), parts.sequence
    record = {
        "sequence": sequence.name,
        "code_version": code_version("imports"),
        "frames": len(sequence.frames),
        "excluded": [],
        "pose_source": sequence.pose_source,
        "map_origin_deg_m": None,
        "grid": parts.layout.grid.as_record(),
        "layout": parts.layout.name,
        "inputs": dict(sequence.inputs),
        "parameters": {"profile": PROFILE, "classes": class_record(classes)},
        "class_share_of_occupied": _shares(counts),
        "filled_share_of_occupied": None,
        "observed_ratio": _observed_ratio(counts, labels),
        "rewritten_frames": labels.notes["rewritten"],
        "profiles": None,
        "refinement": None,
        "ground": None,
        "height_drift": None,
        "track": None,
        "reference": None,
        "map": {
            "voxels": mapped.voxels,
            "tiles": mapped.tiles,
            "vertices": mapped.vertices,
            "triangles": mapped.triangles,
        },
        "solver": None,
        "findings": [finding.as_record() for finding in findings_of(labels)],
    }
    return json.dumps(record, indent=1) + "\n"


def class_record(classes: ClassMap) -> dict[str, Any]:
    """Return the record in the form of a file of `--classes`."""
    words = {number: word for word, number in MEANINGS.items()}
    meant = {str(number): words[meaning] for number, meaning in enumerate(classes.meaning.tolist()) if meaning in words}
    return {"name": classes.name, "classes": meant}


def findings_of(labels: ImportedLabels) -> tuple[Finding, ...]:
    """Return warnings about missing data, for users of the labels."""
    frames, findings = len(labels.ranges), []
    for code, (name, why) in zip(("IMP-601", "IMP-602"), NO_MASK.items(), strict=True):
        if labels.notes[name]:
            findings.append(
                Finding(code, "warning", "", f"{labels.notes[name]} of {frames} frames have no {name}: {why}")
            )
    return tuple(findings)


def _shares(counts: FrameVoxelCounts) -> Mapping[str, float]:
    total = counts.classes.sum(axis=0)
    occupied = max(int(total[1:].sum()), 1)
    return {name: round(float(n) / occupied, 6) for name, n in zip(CLASS_NAMES[1:], total[1:], strict=True)}


def _observed_ratio(counts: FrameVoxelCounts, labels: ImportedLabels) -> Mapping[str, float | None]:
    """Return the observed ratios; null if some frames lack the mask."""
    ratios = counts.observed.sum(axis=0) / np.maximum(counts.classes.sum(), 1)
    pairs = zip((("lidar", "mask_lidar"), ("camera", "mask_camera")), ratios.tolist(), strict=True)
    return {name: None if labels.notes[mask] else round(ratio, 6) for (name, mask), ratio in pairs}
