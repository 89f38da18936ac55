"""Results of stages as files in scratch for later stages: sums of tiles, the reference, counts, packs.

**Conventions.** A pack is the concatenated `labels.npz` of the frames of one part. Its index has the end and the hash
of each frame, so that a frame is read with one ranged request and checked. A run that writes each frame into its own
file has the same indexes and no packs.
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from services.labeler.frames import FrameVoxelCounts, LabelledFrame, counts_of
from services.labeler.map.surface import TileSummary
from services.labeler.parameters import LabelParameters
from services.labeler.run import LabelRun, Part, Step, Tile
from services.labeler.scratch import Arrays, load, save, tile_name, whole
from stone.labels.footprint import Passes
from stone.labels.profiles import VoxelTerrain
from stone.labels.traversability import Reference, no_reference, reference_of_parts
from stone.surface.screened_poisson import Descent

REFERENCE_FILE = "reference.npz"
COUNTED = ("voxels", "points", "moving", "vertices", "triangles")


@dataclass(frozen=True, eq=False)
class PackIndex:
    """`ends_bytes` (n,): the end of each frame, the first starts at 0; `sha256` (n, 32) of each frame."""

    ends_bytes: NDArray[np.int64]
    sha256: NDArray[np.uint8]

    @property
    def size_bytes(self) -> int:
        """The bytes of all frames together."""
        return int(self.ends_bytes[-1])

    def ranges(self) -> list[tuple[int, int, str]]:
        """Return (offset, length, hex sha256) of each frame."""
        starts = np.concatenate([[0], self.ends_bytes[:-1]])
        lengths = self.ends_bytes - starts
        hashes = [row.tobytes().hex() for row in self.sha256]
        return list(zip(starts.tolist(), lengths.tolist(), hashes, strict=True))


def sums_path(run: LabelRun, tile: Tile) -> Path:
    return run.scratch / "sums" / f"{tile_name(tile)}.npz"


def reference_path(run: LabelRun) -> Path:
    return run.scratch / REFERENCE_FILE


def pack_path(run: LabelRun, part: Part) -> Path:
    return run.scratch / "packs" / f"{part[0]:06d}.pack"


def index_path(run: LabelRun, part: Part) -> Path:
    return run.scratch / "packs" / f"{part[0]:06d}.npz"


def save_summary(run: LabelRun, summary: TileSummary) -> None:
    arrays: Arrays = {
        "tile": np.array(summary.tile),
        "keys": summary.driven.keys,
        "terrain": summary.driven.columns,
        "first_m": summary.passes.first_m,
        "last_m": summary.passes.last_m,
        "counted": np.array([getattr(summary, name) for name in COUNTED]),
        "rounds": np.array(summary.descent.rounds),
        "residual_ratio": np.array(summary.descent.residual_ratio),
    }
    save(sums_path(run, summary.tile), arrays)


def load_summaries(run: LabelRun) -> list[TileSummary]:
    """Return the summaries of all tiles, in order."""
    summaries = []
    for path in (run.scratch / "sums").glob("*_*.npz"):
        arrays = load(path)
        driven = VoxelTerrain(arrays["keys"], arrays["terrain"])  # type: ignore[arg-type]
        passes = Passes(arrays["first_m"], arrays["last_m"])  # type: ignore[arg-type]
        descent = Descent(int(arrays["rounds"].item()), float(arrays["residual_ratio"].item()))
        tile = Tile(*arrays["tile"].tolist())
        summaries.append(TileSummary(tile, driven, passes, *arrays["counted"].tolist(), descent))  # type: ignore[call-arg]
    return sorted(summaries, key=lambda summary: summary.tile)


def save_reference(run: LabelRun, reference: Reference) -> None:
    counted = np.array([reference.voxels, reference.is_floored, reference.left_out])
    save(reference_path(run), {"mean": reference.mean, "covariance": reference.covariance, "counted": counted})


def load_reference(run: LabelRun) -> Reference:
    arrays = load(reference_path(run))
    voxels, is_floored, left_out = arrays["counted"].tolist()
    return Reference(arrays["mean"], arrays["covariance"], voxels, bool(is_floored), left_out)  # type: ignore[arg-type]


def reference_from(run: LabelRun, tiles: list[TileSummary], parameters: LabelParameters | None = None) -> Reference:
    """Return the reference of all tiles, in order, by the run's parameters or by others.

    Raises `no_reference`, also without tiles.
    """
    chosen = parameters or run.parameters
    if not tiles:
        raise no_reference(0)
    features = [tile.driven.features(chosen.rule) for tile in tiles]
    # All tiles sum about one point near the ground, which preserves digits of a map high above its datum.
    height_m = 0.0 if chosen.rule.is_local else run.sequence.frames.map_from_ego.translation_m[0, 2]
    return reference_of_parts(features, np.array([height_m, 0.0, 0.0]), chosen.reference)


def write_labels(run: LabelRun, part: Part, frames: Iterable[LabelledFrame], step: Step) -> PackIndex:
    """Write the labels of a part at the run's location, and their index, one step per frame."""
    written, lengths, hashes = list[LabelledFrame](), list[int](), list[bytes]()
    with _labels_written(run, part) as write:
        for frame in frames:
            write(frame)
            lengths.append(len(frame.payload))
            hashes.append(sha256(frame.payload).digest())
            written.append(replace(frame, payload=b""))
            step(len(written), part[1] - part[0])
    counts, sha256s = counts_of(written), np.frombuffer(b"".join(hashes), np.uint8)
    index = PackIndex(np.cumsum(lengths, dtype=np.int64), sha256s.reshape(-1, 32))
    arrays: Arrays = {"ends_bytes": index.ends_bytes, "sha256": sha256s}
    save(index_path(run, part), {**arrays, **vars(counts)})
    return index


@contextmanager
def _labels_written(run: LabelRun, part: Part) -> Iterator[Callable[[LabelledFrame], object]]:
    """Yield a function that writes one frame after another: into the part's pack, or each into its own file."""
    if run.labels_root is not None:
        root = run.labels_root
        yield lambda frame: _write(root / frame.token / "labels.npz", frame.payload)
        return
    with whole(pack_path(run, part)) as staging, staging.open("wb") as file:
        yield lambda frame: file.write(frame.payload)


def _write(path: Path, payload: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(payload)


def load_pack(run: LabelRun, part: Part) -> tuple[PackIndex, FrameVoxelCounts]:
    """Return the pack index of a part, and the counts of its frames."""
    arrays = load(index_path(run, part))
    index = PackIndex(arrays["ends_bytes"], arrays["sha256"].reshape(-1, 32))  # type: ignore[arg-type]
    return index, FrameVoxelCounts(arrays["classes"], arrays["observed"], arrays["filled"])  # type: ignore[arg-type]
