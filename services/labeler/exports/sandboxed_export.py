"""What a sandboxed child does for an export: it opens the files that the parent located, and writes the format's.

**Conventions.** The child writes below its folder's `files`, makes no links, and reads what is named here and no more:
an input of a phase is made where no label, mesh or report is named. Which recording it needs, it says by hashes; what
was imported needs none (`services/domain/sequences/label_sources.py`).
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Annotated, ClassVar

from pydantic import Field

from services.domain.sequences.run_files import SEQUENCE_FILE
from services.labeler.exports.dataset_samples import DatasetSamples
from services.labeler.exports.dataset_source import DatasetSource
from services.labeler.exports.errors import DamagedLabelsError
from services.labeler.exports.inputs import write_sensed
from services.labeler.exports.registry import exporter_of
from services.labeler.exports.source import MESH, REPORT, TABLE, LabelledSequence
from services.runtime.sandbox import ProgressCallback
from services.runtime.sandbox.answers import Hex256, SandboxAnswer
from stone.sensors.samples import CameraSample, LidarSample, RadarSample, SampleSource
from stone.sensors.sequence import Sequence
from stone_recordings.sync.samples import BagSamples
from stone_recordings.sync.sequence_file import read_sequence

FILES = "files"
MOST_INPUTS = 1000
UNASKED = "a format that says it reads no samples reads one"


class SourceAnswer(SandboxAnswer):
    """The hashes of what a sequence was made of."""

    asked: ClassVar[str] = "what a sequence was made of"
    sha256s: Annotated[list[Hex256], Field(max_length=MOST_INPUTS)]


@dataclass(frozen=True)
class LabelRange:
    """Where the labels of a frame lie: a range of a pack, and what it hashes to."""

    token: str
    pack: str
    offset_bytes: int
    length_bytes: int
    sha256: str


@dataclass(frozen=True)
class PackedLabels:
    """The labels of frames as ranges of packs that lie on this machine; a value, so that a child can be given it."""

    packs: Mapping[str, Path]
    ranges: tuple[LabelRange, ...]

    def __call__(self, index: int) -> bytes:
        """Raises `DamagedLabelsError`."""
        at = self.ranges[index]
        with self.packs[at.pack].open("rb") as file:
            file.seek(at.offset_bytes)
            payload = file.read(at.length_bytes)
        if sha256(payload).hexdigest() != at.sha256:
            raise DamagedLabelsError(Path(at.token) / "labels.npz", "its sha256 is another")
        return payload


@dataclass(frozen=True)
class ExportInputs:
    """What an export is made of: a folder with the sequence's files by their names, its labels, and what was measured.

    That is the `recording`, or the `source` of labels that were imported. What is left out the format does not ask for.
    """

    folder: Path
    labels: PackedLabels
    recording: Path | None = None
    source: DatasetSource | None = None

    def sequence(self) -> Sequence:
        return read_sequence((self.folder / SEQUENCE_FILE).read_bytes())

    def opened(self) -> LabelledSequence:
        """The labelled sequence."""
        sequence = self.sequence()
        report = json.loads((self.folder / REPORT).read_text("utf-8"))
        samples, published = self.samples(sequence), self.source.opened() if self.source else None
        files = (self.folder / MESH, self.folder / TABLE)
        return LabelledSequence(sequence, samples, self.labels, report, *files, published)

    def samples(self, sequence: Sequence) -> SampleSource:
        if self.source is not None:
            return DatasetSamples(self.source, sequence)
        return NoSamples() if self.recording is None else BagSamples(self.recording, sequence)


class NoSamples:
    """The samples of an export whose format says that it reads none; asked all the same, it raises ValueError."""

    def lidar(self, index: int) -> LidarSample:
        raise ValueError(UNASKED)

    def camera(self, channel: str, index: int) -> CameraSample | None:
        raise ValueError(UNASKED)

    def radar(self, channel: str, index: int) -> RadarSample | None:
        raise ValueError(UNASKED)


def source_of(inputs: ExportInputs, _folder: Path, _progress: ProgressCallback) -> bytes:
    """Which recordings the sequence was made of."""
    return SourceAnswer(sha256s=sorted(set(inputs.sequence().inputs.values()))).packed()


def write_format(name: str, inputs: ExportInputs, folder: Path, progress: ProgressCallback) -> bytes:
    """The files of the format called so. Raises what its exporter raises."""
    exporter_of(name)(inputs.opened(), folder / FILES, partial(progress, name))
    return b""


def write_phase_input(inputs: ExportInputs, folder: Path, progress: ProgressCallback) -> bytes:
    """The files of an input of a phase: what was sensed, and nothing that was derived from it."""
    sequence = inputs.sequence()
    write_sensed(sequence, inputs.samples(sequence), folder / FILES, partial(progress, "inputs"))
    return b""
