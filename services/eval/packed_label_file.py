"""The label file of a frame in a pack of the store: where it lies and what it hashes to."""

from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from services.eval.ground_truth import MAX_LABELS_BYTES
from services.eval.scoring_errors import LabelsUnfitError
from services.runtime.store.pack_reading import ShortPackError


@dataclass(frozen=True)
class PackedLabelFile:
    """A range of the pack of this number, and the sha256 of what is there; a plain value, for sandboxed children."""

    name: str
    pack: int
    offset_bytes: int
    length_bytes: int
    sha256: str

    def read(self, packs: Mapping[int, Path]) -> bytes:
        """The npz, of packs by number. Raises `LabelsUnfitError`, `ShortPackError`."""
        if self.length_bytes > MAX_LABELS_BYTES:
            raise LabelsUnfitError(f"file {self.name}", f"longer than {MAX_LABELS_BYTES} bytes")
        with packs[self.pack].open("rb") as pack:
            pack.seek(self.offset_bytes)
            npz = pack.read(self.length_bytes)
        if len(npz) < self.length_bytes:
            raise ShortPackError(self.pack, self.offset_bytes + len(npz))
        if sha256(npz).hexdigest() != self.sha256:
            raise LabelsUnfitError(f"file {self.name}", "its sha256 is another than the index says")
        return npz
