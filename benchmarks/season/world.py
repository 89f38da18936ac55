"""The world of a season: a test split of a few sequences in three versions of the dataset, and varied predictions.

**Conventions.** Versions are inserted as rows before the platform starts, with the same frames and other labels.
Predictions are mixtures of the labels and a network's output (`benchmarks/grids.py`): quality k of `LEVELS` determines
the network's share of a frame, in patches. A submission picks a quality for each frame, so that all submissions differ,
and no grid is drawn twice.
"""

import zipfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import update

from benchmarks.grids import fractal, frames
from services.runtime.access import users
from services.runtime.orm import Job, SequenceRow
from services.runtime.platform import Platform
from stone.labels.grid import Grid
from stone.sensors.sequence import frame_token
from stone_files.npz import npz_bytes
from testing.worlds import made, published

LEVELS = 8
VERSIONS = ("stone-1.0", "stone-1.1", "stone-1.2")
CORRECTED_RATIO = 0.03  # corrected share of each frame per version
CONDITIONS = (("quarry", "day"), ("farmland", "dusk"), ("forest", "night"), ("lake", "day"))


@dataclass(frozen=True)
class SeasonSize:
    """The size of a season."""

    teams: int = 30
    submissions: int = 600
    sequences: int = 4
    frames: int = 15
    scorings: int = 12
    seed: int = 1


@dataclass(frozen=True, eq=False)
class Predictions:
    """The npz of every frame at every quality, best first, by token."""

    npz: dict[str, tuple[bytes, ...]]

    def pack(self, path: Path, levels: Iterable[int], spoil: str = "") -> Path:
        """Write a zip of one prediction per frame; `spoil` leaves one out (`missing`) or breaks one (`broken`)."""
        with zipfile.ZipFile(path, "w") as archive:
            for number, (token, level) in enumerate(zip(self.npz, levels, strict=True)):
                content = self.npz[token][level]
                if number or not spoil:
                    archive.writestr(f"{token}.npz", content)
                elif spoil == "broken":
                    archive.writestr(f"{token}.npz", content[: len(content) // 2])
        return path


def build_season_world(platform: Platform, size: SeasonSize) -> Predictions:
    """Create three versions whose test split has `size.sequences` sequences; return predictions for all frames."""
    with platform.database.transaction() as session:
        owner_id = users.create_user(session, "surveyor", "curator").id
    drawn = [list(frames(size.frames, size.seed + number)) for number in range(size.sequences)]
    facts = [_sequence(platform, owner_id, number) for number in range(size.sequences)]
    truths = [[truth for truth, _ in of_sequence] for of_sequence in drawn]
    for version, name in enumerate(VERSIONS):
        for number, (sequence, of_sequence) in enumerate(zip(facts, truths, strict=True)):
            contents = [_labels(grid) for grid in of_sequence]
            made.labels(platform, sequence, seed=f"{name} {number} ".encode(), contents=contents)
        published.dataset(platform, owner_id, {"test": [fact["id"] for fact in facts]}, name)
        truths = [_corrected(of, 100 * version + k) for k, of in enumerate(truths)]
    with platform.database.transaction() as session:  # the labels' source runs
        session.execute(update(Job).where(Job.state == "queued").values(state="succeeded"))
    return Predictions(dict(_predictions(facts, drawn, size.seed)))


def _sequence(platform: Platform, owner_id: str, number: int) -> dict[str, str]:
    environment, illumination = CONDITIONS[number % len(CONDITIONS)]
    with platform.database.transaction() as session:
        row = SequenceRow(owner_id=owner_id, name=f"test-{number}", environment=environment, illumination=illumination)
        session.add(row)
        session.flush()
        return {"id": row.id, "name": row.name, "owner_id": owner_id}


def _corrected(labels: list[Grid], seed: int) -> list[Grid]:
    """Return the labels with repaired patches."""
    patches = (_patches(seed, index) < CORRECTED_RATIO for index in range(len(labels)))
    mended = (np.where(grid > 0, grid % 3 + 1, 0).astype(np.uint8) for grid in labels)
    return [
        np.where(is_mended[..., None], new, old) for is_mended, new, old in zip(patches, mended, labels, strict=True)
    ]


def _predictions(
    facts: list[dict[str, str]], drawn: list[list[tuple[Grid, Grid]]], seed: int
) -> Iterator[tuple[str, tuple[bytes, ...]]]:
    for number, (sequence, of_sequence) in enumerate(zip(facts, drawn, strict=True)):
        for index, (truth, predicted) in enumerate(of_sequence):
            share = _patches(seed + 7919 * number, index)
            grids = (np.where((share < (level + 1) / LEVELS)[..., None], predicted, truth) for level in range(LEVELS))
            yield (
                frame_token(sequence["name"], made.stamp_of(index)),
                tuple(npz_bytes({"semantics": grid}) for grid in grids),
            )


def _patches(seed: int, index: int) -> NDArray[np.float64]:
    """Return ranks in [0, 1) over the squares of a frame, similar for neighbours: the share of ranks below q is q."""
    field = fractal(np.random.default_rng((seed, index)), 256, 1.6, 60)
    ranks = np.empty(field.size)
    ranks[np.argsort(field, axis=None)] = np.arange(field.size) / field.size
    return ranks.reshape(field.shape)


def _labels(grid: Grid) -> bytes:
    seen = np.ones(grid.shape, np.uint8)
    return npz_bytes({"semantics": grid, "mask_lidar": seen, "mask_camera": seen})
