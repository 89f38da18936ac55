"""A phase of an imported dataset: a submission is scored by the platform, and counted by NumPy alone."""

import io
import time
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stone_client.api import Api
from stone_client.sdk import ignore_progress
from stone_client.server.scores import read_results
from stone_client.server.submission import SubmissionDescription, settled, submit
from testing.worlds.published_datasets import SyntheticDataset

LOOK_S, ROUNDED = 1.0, 1e-4
RATIOS = ("iou_occ", "iou_t", "iou_p", "iou_n", "miou")
REASON = "a benchmark of imports"


class ScoredOtherwiseError(Exception):
    """The platform's scores differ from NumPy's counts."""


def scored(api: Api, dataset: SyntheticDataset, folder: Path) -> str:
    """Publish a version of the imported splits, open a hidden phase on its test split, submit and compare.

    The prediction of a frame is the labels of the next kind. Raises `ScoredOtherwiseError`.
    """
    begun = time.perf_counter()
    api.create("/datasets", {"name": "release-1.0", "licence": "CC-BY-4.0", "reason": REASON})
    phase = {"name": "test", "part": "test", "mask": "lidar", "is_hidden": True, "scorings_per_window": 5}
    body = {"name": "release", "dataset": "release-1.0", "phases": [phase], "reason": REASON}
    phase_id = api.create("/admin/benchmarks", body)["phases"][0]["id"]
    api.create(f"/admin/phases/{phase_id}/ground-truths", {"reason": REASON})
    while api.read("/benchmarks/release/phases/test")["active"] is None:
        time.sleep(LOOK_S)
    team = api.create("/teams", {"name": "Next Kind"})
    entry = SubmissionDescription(phase_id, team["id"], "next kind", "L")
    sent = settled(api, submit(api, _packed(folder / "sub.zip", dataset), entry, ignore_progress), ignore_progress)
    ours, theirs = _counted(dataset), read_results(api, sent["id"])["total"]
    if any(abs(ours[name] - theirs[name]) > ROUNDED for name in RATIOS):
        raise ScoredOtherwiseError(f"platform {theirs}, NumPy {ours}")
    frames = sum(dataset.length(scene) for scene in _test_scenes(dataset))
    took = time.perf_counter() - begun
    counted = f"mIoU {theirs['miou']:.4f}, as NumPy counts"
    return f"a hidden phase of {frames} frames, a submission scored in {took:.0f} s: {counted}"


def _test_scenes(dataset: SyntheticDataset) -> list[int]:
    return [scene for scene, name in enumerate(dataset.names) if name in (dataset.splits or {})["test"]]


def _kinds(dataset: SyntheticDataset) -> list[dict[str, NDArray[Any]]]:
    return [dict(np.load(io.BytesIO(labels))) for labels in dataset.labels]


def _packed(path: Path, dataset: SyntheticDataset) -> Path:
    kinds = []
    for kind in _kinds(dataset):
        buffer = io.BytesIO()
        np.savez_compressed(buffer, semantics=kind["semantics"])
        kinds.append(buffer.getvalue())
    with zipfile.ZipFile(path, "w") as archive:
        for scene in _test_scenes(dataset):
            for frame, token in enumerate(dataset.tokens(scene)):
                archive.writestr(f"{token}.npz", kinds[(frame + 1) % len(kinds)])
    return path


def _counted(dataset: SyntheticDataset) -> dict[str, float]:
    """Return the ratios of the confusion over voxels observed by the LiDAR."""
    kinds = _kinds(dataset)
    confusion = np.zeros((4, 4), np.int64)
    for scene in _test_scenes(dataset):
        for frame in range(len(kinds)):
            times = len(range(frame, dataset.length(scene), len(kinds)))
            truth, prediction = kinds[frame], kinds[(frame + 1) % len(kinds)]["semantics"]
            seen = truth["mask_lidar"] == 1
            pairs = truth["semantics"][seen].astype(np.int64) * 4 + prediction[seen]
            confusion += times * np.bincount(pairs, minlength=16).reshape(4, 4)
    occupied = confusion[1:, 1:].sum() / (confusion.sum() - confusion[0, 0])
    t, p, n = (confusion[k, k] / (confusion[k].sum() + confusion[:, k].sum() - confusion[k, k]) for k in (1, 2, 3))
    return dict(zip(RATIOS, map(float, (occupied, t, p, n, (t + p + n) / 3)), strict=True))
