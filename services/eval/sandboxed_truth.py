"""Builds the pack of a ground truth in a sandboxed child: opens label files and writes their bit planes.

**Conventions.** Label files derive from untrusted recordings or were imported, so only the child opens them, compares
each with its digest, and reads them as strictly as a submission's. It reads the given packs, writes one file in its
folder, and returns the facts for the row. The parent makes the manifest from names.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Annotated, ClassVar

from pydantic import Field

from services.eval.ground_truth import truth_in
from services.eval.truth_pack import write_truth_pack
from services.runtime.sandbox import ProgressCallback
from services.runtime.sandbox.answers import Hex256, SandboxAnswer
from services.runtime.store.packs import short_pack
from stone.errors import Refused
from stone.scoring.frame_counts import TruthPlanes
from stone_submissions.errors import GroundTruthError
from stone_submissions.ground_truth import MAX_LABELS_BYTES, Mask
from stone_submissions.manifest import MAX_FRAMES, Manifest

PACK = "truth.pack"


@dataclass(frozen=True)
class PackedLabelFile:
    """A range of the pack with this number, and the sha256 of its content; a plain value, for sandboxed children."""

    name: str
    pack: int
    offset_bytes: int
    length_bytes: int
    sha256: str

    def read(self, packs: Mapping[int, Path]) -> bytes:
        """Return the npz from the packs by number. Raises `labels_unfit`, `short_pack`."""
        if self.length_bytes > MAX_LABELS_BYTES:
            raise labels_unfit(f"file {self.name}", f"it is longer than {MAX_LABELS_BYTES} bytes")
        with packs[self.pack].open("rb") as pack:
            pack.seek(self.offset_bytes)
            npz = pack.read(self.length_bytes)
        if len(npz) < self.length_bytes:
            raise short_pack(self.pack, self.offset_bytes + len(npz))
        if sha256(npz).hexdigest() != self.sha256:
            raise labels_unfit(f"file {self.name}", "its sha256 differs from the index")
        return npz


class TruthAnswer(SandboxAnswer):
    """The child's answer: the sha256 of all evaluated voxels, and the number of frames."""

    expected: ClassVar[str] = "the summary of the built pack"
    sha256: Hex256
    frames: Annotated[int, Field(gt=0, le=MAX_FRAMES)]


@dataclass(frozen=True)
class TruthInputs:
    """Inputs of a ground truth: packs by number, and the label file of each frame by token; a plain value."""

    packs: Mapping[int, Path]
    files: Mapping[str, PackedLabelFile]
    manifest: Manifest
    mask: Mask

    def planes(self, token: str) -> TruthPlanes:
        """Read one frame. Raises `labels_unfit`, whose sentence quotes nothing of the file, and `short_pack`."""
        file = self.files[token]
        try:
            return truth_in(file.read(self.packs), self.mask, Path(file.name), self.manifest.grid)
        except GroundTruthError as error:
            raise labels_unfit(f"file {file.name}", "it lacks the arrays that the phase needs") from error


def write_truth(inputs: TruthInputs, folder: Path, progress: ProgressCallback) -> bytes:
    """Write the pack of all frames into the folder. Raises as `TruthInputs.planes`."""
    summary = write_truth_pack(folder / PACK, inputs.manifest, inputs.planes, threads=1, progress=progress)
    return TruthAnswer(sha256=summary.sha256, frames=summary.frames).packed()


def labels_unfit(where: str, fault: str) -> Refused:
    return Refused("labels_unfit", f"{where} of the dataset version: {fault}; was it written by STONE?")
