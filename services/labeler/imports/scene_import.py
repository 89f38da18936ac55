"""What a sandboxed child does to import one scene of a dataset that was indexed.

    spans in the tar → files checked and copied → labels checked and copied, their map fused → products, report, totals

**Conventions.** Everything goes to the folder `out` of the scene by the names of artefacts; what is needed on the way
lies in a folder beside, which is removed.
"""

import shutil
from collections.abc import Mapping
from pathlib import Path

from services.domain.sequences.run_files import SEQUENCE_FILE
from services.labeler.exports.source import REPORT, TABLE
from services.labeler.frames import FrameVoxelCounts
from services.labeler.imports.fused_labels import FusedLabels
from services.labeler.imports.import_report import report_text
from services.labeler.imports.label_files import ImportedLabels, copied_labels
from services.labeler.imports.map_products import write_map_products
from services.labeler.imports.openings import OUT, SceneOpening, scene_folder
from services.labeler.imports.scene_parts import SceneParts, read_scene_parts
from services.labeler.imports.source_files import write_source
from services.labeler.run_answers import PublicationAnswer, TotalsAnswer
from services.labeler.tables import CLASS_COLUMNS, write_frames
from services.runtime.sandbox import ProgressCallback
from stone.splits.composition import duration_ns, path_length_m

SCRATCH = "scratch"


def import_scene(opening: SceneOpening, folder: Path, progress: ProgressCallback) -> bytes:
    """Leave the artefacts of the scene in `scenes/<ordinal>/out`; a `PublicationAnswer`.

    Raises the first `DatasetFaultError` that is found, `SceneDamagedError`, `BadMemberError`, `StoreFullError`.
    """
    scene = folder / scene_folder(opening.ordinal)
    parts, out = read_scene_parts(scene, opening.dataset), scene / OUT
    for made in (out, scene / SCRATCH):
        shutil.rmtree(made, ignore_errors=True)
        made.mkdir()
    write_source(parts, out, lambda done, total: progress("copy", done, total))
    labels = _labels(parts, opening, progress)
    shutil.copyfile(scene / SEQUENCE_FILE, out / SEQUENCE_FILE)
    write_frames(out / TABLE, parts.sequence, labels.counts())
    shutil.rmtree(scene / SCRATCH)
    return _answer(parts, labels).packed()


def _labels(parts: SceneParts, opening: SceneOpening, progress: ProgressCallback) -> ImportedLabels:
    """The labels in packs, and what is made of them."""
    sequence, out, labels = parts.sequence, parts.folder / OUT, ImportedLabels()
    scratch = parts.folder / SCRATCH
    fused, poses = FusedLabels(sequence.name, scratch / "votes"), sequence.frames.map_from_ego
    for frame, classes in enumerate(copied_labels(parts, opening.classes, out, labels)):
        fused.add(classes, poses[frame])
        progress("labels", frame + 1, len(poses))
    mapped = write_map_products(fused, sequence, (out, scratch), lambda done, total: progress("map", done, total))
    (out / REPORT).write_text(report_text(sequence, opening.classes, labels, mapped))
    return labels


def _answer(parts: SceneParts, labels: ImportedLabels) -> PublicationAnswer:
    frames = parts.sequence.frames
    return PublicationAnswer(
        tokens=list(frames.tokens),
        stamps_ns=frames.stamps_ns.tolist(),
        packs=labels.packs(),
        totals=TotalsAnswer(
            duration_ns=duration_ns(frames.stamps_ns),
            distance_m=path_length_m(frames.map_from_ego.translation_m),
            **voxel_totals(labels.counts()),
        ),
    )


def voxel_totals(counts: FrameVoxelCounts) -> Mapping[str, int]:
    """Voxels of all frames by class, by the names of columns."""
    return dict(zip(CLASS_COLUMNS, counts.classes.sum(axis=0).tolist(), strict=True))
