"""Simulated worlds as training exports: recorded, labelled and exported once, and stored."""

import json
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from stone_submissions.manifest import Manifest, write_manifest

EXPORT, LABELS, JUDGED, MANIFEST = "export", "labels", "judged", "manifest.json"


@dataclass(frozen=True)
class ModelWorld:
    """One world's folder."""

    folder: Path
    seed: int

    @property
    def export(self) -> Path:
        return self.folder / EXPORT

    @property
    def manifest(self) -> Path:
        """The manifest of every n-th frame."""
        return self.folder / MANIFEST

    @property
    def ground_truth(self) -> Path:
        """The labels of the manifest's frames."""
        return self.folder / JUDGED


def made_world(folder: Path, seed: int, seconds: float, every: int) -> ModelWorld:
    """Return the world of this seed, created or from an earlier run."""
    world = ModelWorld(folder / f"world-{seed}", seed)
    if not world.manifest.exists():
        shutil.rmtree(world.folder, ignore_errors=True)
        world.folder.mkdir(parents=True)
        bag, labels = world.folder / f"world{seed}.mcap", world.folder / LABELS
        stone("simulate", bag, "--seconds", seconds, "--seed", seed, "--camera-detail", "full")
        stone("label", bag, "--calibration", bag.with_suffix(".calibration.yaml"), "-o", labels)
        stone("export", labels, "--format", "nuscenes", "-o", world.export)
        _choose_frames(world, every)
    return world


def stone(*words: object) -> None:
    """Run the command without its output."""
    command = [sys.executable, "-m", "stone_client.main", *(str(word) for word in words)]
    subprocess.run(command, check=True, capture_output=True)


def _choose_frames(world: ModelWorld, every: int) -> None:
    """Write the manifest of every n-th frame, and its ground truth."""
    rows = json.loads((world.export / "v1.0-trainval" / "sample.json").read_text("utf-8"))
    tokens = [row["token"] for row in sorted(rows, key=lambda row: row["timestamp"])][::every]
    [sequence] = [path.name for path in (world.export / "gts").iterdir()]
    for token in tokens:
        relative = Path("gts") / sequence / token
        (world.ground_truth / relative).mkdir(parents=True)
        shutil.copy(world.export / relative / "labels.npz", world.ground_truth / relative)
    write_manifest(world.manifest, Manifest({sequence: tuple(tokens)}))
