"""The release layout: nuScenes tables and samples, Occ3D labels. The page to read first.

    v1.0-trainval/<table>.json   samples/<CHANNEL>/n001-<UTC>__<CHANNEL>__<µs>.{jpg,pcd.bin,pcd}
    gts/<sequence>/<frame_token>/labels.npz   maps/<token>.png

**Conventions.** As in `services/labeler/exports/nuscenes/samples.py`; the map is shifted by whole metres until all of
it has positive coordinates, and the mask of it says where one could drive. What was imported is written as it was
published: its own tables, samples and maps, byte for byte.
"""

from collections.abc import Callable
from pathlib import Path

from services.labeler.exports.nuscenes.map_mask import mask_of, write_mask
from services.labeler.exports.nuscenes.plan import NuscenesPlan, channels_of
from services.labeler.exports.nuscenes.samples import write_samples
from services.labeler.exports.ply_file import open_mesh
from services.labeler.exports.source import LabelledSequence
from services.labeler.run import Step


def write_nuscenes(source: LabelledSequence, out: Path, step: Step) -> None:
    """Write the sequence into the empty folder `out`.

    Raises what `write_samples` raises, `DamagedLabelsError`, `MapTooLargeError`, `DamagedExportError`.
    """
    sequence, frames = source.sequence, source.sequence.frames

    def label(index: int) -> None:
        labels = out / "gts" / sequence.name / frames.tokens[index] / "labels.npz"
        labels.parent.mkdir(parents=True)
        labels.write_bytes(source.labels(index))
        step(index + 1, len(frames))

    if source.published is None:
        _write_recorded(source, out, label)
        return
    source.published.write(out)
    for index in range(len(frames)):
        label(index)


def _write_recorded(source: LabelledSequence, out: Path, label: Callable[[int], None]) -> None:
    """Tables, samples and maps of a sequence that was recorded; `label` is called for each frame."""
    sequence = source.sequence
    mask = mask_of(open_mesh(source.mesh), sequence.frames.map_from_ego.translation_m[:, :2])
    plan = NuscenesPlan(sequence, channels_of(sequence), mask.low_m)
    (out / "maps").mkdir()
    write_mask(out / plan.mask_filename, mask)
    write_samples(source.samples, plan, out, label)
