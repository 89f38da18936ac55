"""Exports for participants: the sensor data of a sequence without anything derived from its labels.

    v1.0-trainval/<table>.json   samples/<CHANNEL>/n001-<UTC>__<CHANNEL>__<µs>.{jpg,pcd.bin,pcd}   maps/<token>.png

**Conventions.** The release layout (`services/labeler/exports/nuscenes/samples.py`), so what reads train reads test.
It is made of the synchronised sequence and its recording alone, so no number of it can come from a label: the map is
shifted by where the robot drove, and the mask, without which the devkit opens nothing, is black.
"""

from pathlib import Path

from services.labeler.exports.nuscenes.map_mask import blank_mask, write_mask
from services.labeler.exports.nuscenes.plan import NuscenesPlan, channels_of
from services.labeler.exports.nuscenes.samples import write_samples
from services.labeler.exports.source import LabelledSequence
from services.labeler.run import Step
from stone.sensors.samples import SampleSource
from stone.sensors.sequence import Sequence


def write_inputs(source: LabelledSequence, out: Path, step: Step) -> None:
    """The exporter: of the labelled sequence only sequence and samples are looked at."""
    write_sensed(source.sequence, source.samples, out, step)


def write_sensed(sequence: Sequence, samples: SampleSource, out: Path, step: Step) -> None:
    """Write the sequence into the empty folder `out`. Raises what `write_samples` raises."""
    mask = blank_mask(sequence.frames.map_from_ego.translation_m[:, :2])
    plan = NuscenesPlan(sequence, channels_of(sequence), mask.low_m)
    (out / "maps").mkdir()
    write_mask(out / plan.mask_filename, mask)
    total = len(sequence.frames)
    write_samples(samples, plan, out, lambda index: step(index + 1, total))
