"""What a sandboxed child does for a ground truth: it opens label files, and writes the pack of their bit planes.

**Conventions.** Label files were computed from what a stranger recorded, or brought as they are, so only the child
opens them, each held against its digest and read as strictly as a submission's. It reads the packs that it is named,
writes one file in its folder, and answers with what the row is to say. The manifest is the parent's, made of names.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from pydantic import Field

from services.eval.ground_truth import Mask, truth_in
from services.eval.packed_label_file import PackedLabelFile
from services.eval.scoring_errors import LabelsUnfitError
from services.eval.truth_pack import write_truth_pack
from services.runtime.sandbox import ProgressCallback
from services.runtime.sandbox.answers import Hex256, SandboxAnswer
from stone.scoring.bitplanes import TruthPlanes
from stone_submissions.errors import GroundTruthError
from stone_submissions.manifest import MAX_FRAMES, Manifest

PACK = "truth.pack"


class TruthAnswer(SandboxAnswer):
    """What was built: the hash of everything evaluated, and of how many frames."""

    asked: ClassVar[str] = "what was built"
    sha256: Hex256
    frames: Annotated[int, Field(gt=0, le=MAX_FRAMES)]


@dataclass(frozen=True)
class TruthInputs:
    """What a ground truth is built of: packs by number, the label file of each frame by token; a plain value."""

    packs: Mapping[int, Path]
    files: Mapping[str, PackedLabelFile]
    manifest: Manifest
    mask: Mask

    def planes(self, token: str) -> TruthPlanes:
        """Of one frame. Raises `LabelsUnfitError`, which says nothing of what the file holds, and `ShortPackError`."""
        file = self.files[token]
        try:
            return truth_in(file.read(self.packs), self.mask, Path(file.name))
        except GroundTruthError as error:
            raise LabelsUnfitError(f"file {file.name}", "no label file with the arrays that the phase needs") from error


def write_truth(inputs: TruthInputs, folder: Path, progress: ProgressCallback) -> bytes:
    """The pack of all frames, written into the folder. Raises as `TruthInputs.planes`."""
    summary = write_truth_pack(folder / PACK, inputs.manifest, inputs.planes, threads=1, progress=progress)
    return TruthAnswer(sha256=summary.sha256, frames=summary.frames).packed()
