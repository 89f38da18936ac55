"""What a stage concluded, as files in scratch that later stages read: sums of tiles, the reference, counts, packs.

**Conventions.** A pack is the `labels.npz` of the frames of one part, one after another; its index says where each
begins and ends and what it hashes to, so that a frame is read by one ranged request and checked.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from services.labeler.frames import FrameCounts, LabelledFrame, counts_of
from services.labeler.run import Part, Run, Step, Tile
from services.labeler.scratch import Arrays, load, save, tile_name, whole
from services.labeler.surface import TileSummary
from stone.traversability import FeatureSums, Reference

COUNTED = ("voxels", "points", "moving", "vertices", "triangles")


@dataclass(frozen=True, eq=False)
class PackIndex:
    """`ends_bytes` (n,): where each frame ends, the first begins at 0; `sha256` (n, 32) of each frame."""

    ends_bytes: NDArray[np.int64]
    sha256: NDArray[np.uint8]

    def ranges(self) -> list[tuple[int, int, str]]:
        """(offset, length, hex sha256) of each frame."""
        starts = np.concatenate([[0], self.ends_bytes[:-1]])
        lengths = self.ends_bytes - starts
        hashes = [row.tobytes().hex() for row in self.sha256]
        return list(zip(starts.tolist(), lengths.tolist(), hashes, strict=True))


def sums_path(run: Run, tile: Tile) -> Path:
    return run.scratch / "sums" / f"{tile_name(tile)}.npz"


def reference_path(run: Run) -> Path:
    return run.scratch / "reference.npz"


def pack_path(run: Run, part: Part) -> Path:
    return run.scratch / "packs" / f"{part[0]:06d}.pack"


def index_path(run: Run, part: Part) -> Path:
    return run.scratch / "packs" / f"{part[0]:06d}.npz"


def save_summary(run: Run, summary: TileSummary) -> None:
    arrays: Arrays = {
        "tile": np.array(summary.tile),
        **_sums_arrays(summary.sums, ""),
        **_sums_arrays(summary.other_sums, "other_"),
        "counted": np.array([getattr(summary, name) for name in COUNTED]),
    }
    save(sums_path(run, summary.tile), arrays)


def _sums_arrays(sums: FeatureSums, prefix: str) -> Arrays:
    arrays: Arrays = {"origin": sums.origin, "count": np.array(sums.count), "total": sums.total, "outer": sums.outer}
    return {f"{prefix}{name}": array for name, array in arrays.items()}


def _sums_from(arrays: Arrays, prefix: str) -> FeatureSums:
    origin, total, outer = (arrays[f"{prefix}{name}"] for name in ("origin", "total", "outer"))
    return FeatureSums(origin, int(arrays[f"{prefix}count"].item()), total, outer)  # type: ignore[arg-type]


def load_summaries(run: Run) -> list[TileSummary]:
    """Of all tiles, in their order."""
    summaries = []
    for path in (run.scratch / "sums").glob("*_*.npz"):
        arrays = load(path)
        i, j = arrays["tile"].tolist()
        both = (_sums_from(arrays, ""), _sums_from(arrays, "other_"))
        summaries.append(TileSummary((i, j), *both, *arrays["counted"].tolist()))
    return sorted(summaries, key=lambda summary: summary.tile)


def save_reference(run: Run, reference: Reference) -> None:
    facts: Arrays = {"voxels": np.array(reference.voxels), "is_floored": np.array(reference.is_floored)}
    save(reference_path(run), {"mean": reference.mean, "covariance": reference.covariance, **facts})


def load_reference(run: Run) -> Reference:
    arrays = load(reference_path(run))
    voxels, is_floored = int(arrays["voxels"].item()), bool(arrays["is_floored"].item())
    return Reference(arrays["mean"], arrays["covariance"], voxels, is_floored)  # type: ignore[arg-type]


def write_pack(run: Run, part: Part, frames: Iterable[LabelledFrame], step: Step) -> FrameCounts:
    """Write the pack of a part and its index, a step each frame."""
    written, ends, hashes = list[LabelledFrame](), list[int](), list[bytes]()
    with whole(pack_path(run, part)) as staging, staging.open("wb") as file:
        for frame in frames:
            file.write(frame.payload)
            ends.append(file.tell())
            hashes.append(sha256(frame.payload).digest())
            written.append(LabelledFrame(frame.token, b"", frame.classes, frame.observed))
            step(len(written), part[1] - part[0])
    counts = counts_of(written)
    index: Arrays = {"ends_bytes": np.array(ends, np.int64), "sha256": np.frombuffer(b"".join(hashes), np.uint8)}
    save(index_path(run, part), {**index, "classes": counts.classes, "observed": counts.observed})
    return counts


def load_pack(run: Run, part: Part) -> tuple[PackIndex, FrameCounts]:
    """Where the frames of a part lie in its pack, and their counts."""
    arrays = load(index_path(run, part))
    index = PackIndex(arrays["ends_bytes"], arrays["sha256"].reshape(-1, 32))  # type: ignore[arg-type]
    return index, FrameCounts(arrays["classes"], arrays["observed"])  # type: ignore[arg-type]
