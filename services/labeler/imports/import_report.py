"""`report.json` of an imported label set: from what it was taken, what its classes mean, and what it has not.

**Conventions.** The keys that it shares with the labeler's own report (`services/labeler/report.py`) mean the same;
what only a labelling knows is null.
"""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from services.labeler.frames import FrameVoxelCounts
from services.labeler.imports.label_files import ImportedLabels
from services.labeler.imports.map_products import PROFILE, MapFacts
from services.labeler.report import CLASS_NAMES
from services.runtime.code_version import code_version
from stone.findings import Finding
from stone.sensors.sequence import Sequence
from stone_datasets.classes import MEANINGS, ClassMap

NO_MASK = {
    "mask_lidar": "which voxels a ray reached is unknown: free voxels may never have been observed",
    "mask_camera": "which voxels a camera sees is unknown: scores within the cameras' view count all",
}


def report_text(sequence: Sequence, classes: ClassMap, labels: ImportedLabels, mapped: MapFacts) -> str:
    """The file."""
    counts = labels.counts()
    record = {
        "sequence": sequence.name,
        "code_version": code_version("imports"),
        "frames": len(sequence.frames),
        "excluded": [],
        "pose_source": sequence.pose_source,
        "map_origin_deg_m": None,
        "inputs": dict(sequence.inputs),
        "parameters": {"profile": PROFILE, "classes": class_record(classes)},
        "class_share_of_occupied": _shares(counts),
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
    """As a file of `--classes` says it."""
    words = {number: word for word, number in MEANINGS.items()}
    meant = {str(number): words[meaning] for number, meaning in enumerate(classes.meaning.tolist()) if meaning in words}
    return {"name": classes.name, "classes": meant}


def findings_of(labels: ImportedLabels) -> tuple[Finding, ...]:
    """What the dataset does not say, as somebody who uses its labels should know."""
    frames, found = len(labels.ranges), []
    for code, (name, why) in zip(("IMP-601", "IMP-602"), NO_MASK.items(), strict=True):
        if labels.notes[name]:
            found.append(Finding(code, "warning", "", f"{labels.notes[name]} of {frames} frames have no {name}: {why}"))
    return tuple(found)


def _shares(counts: FrameVoxelCounts) -> Mapping[str, float]:
    total = counts.classes.sum(axis=0)
    occupied = max(int(total[1:].sum()), 1)
    return {name: round(float(n) / occupied, 6) for name, n in zip(CLASS_NAMES[1:], total[1:], strict=True)}


def _observed_ratio(counts: FrameVoxelCounts, labels: ImportedLabels) -> Mapping[str, float | None]:
    """Null where not every frame says."""
    ratios = counts.observed.sum(axis=0) / np.maximum(counts.classes.sum(), 1)
    pairs = zip((("lidar", "mask_lidar"), ("camera", "mask_camera")), ratios.tolist(), strict=True)
    return {name: None if labels.notes[mask] else round(ratio, 6) for (name, mask), ratio in pairs}
