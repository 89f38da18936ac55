"""A row that trains in milliseconds, on small exports written by formula, and what its runs leave."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load_file
from torch import Tensor

from baselines.checkpoint import CHECKPOINT, WEIGHTS
from baselines.row_config import RowConfig, row_of
from baselines.run_folder import LOG, TrainingReport
from baselines.train import TrainedRun, TrainingPlan, train

TRAINING: Mapping[str, Any] = {
    "epochs": 2, "batch": 2, "learning_rate": 3e-3, "precision": "float32", "warmup_steps": 2, "checkpoint_steps": 2,
}  # fmt: skip
LATTICE: Mapping[str, Any] = {"min_m": [-3.2, -3.2, -1.2], "shape": [32, 32, 16]}
MODEL: Mapping[str, Any] = {
    "architecture": "openocc",
    "modality": "L",
    "lattice": LATTICE,
    "volume_channels": 8,
    "sparse_channels": 4,
    "residual_channels": [8, 8, 8, 8],
    "residual_blocks": [1, 1, 1, 1],
    "pyramid_channels": 8,
}


def row_record(**training: Any) -> dict[str, Any]:
    """What a YAML file of the row holds."""
    return {
        "name": "small",
        "method": "Small",
        "reference": "none",
        "inputs": {"modality": "L", "lidar_sweeps": 3},
        "model": dict(MODEL),
        "training": {**TRAINING, **training},
    }


def small_row(**training: Any) -> RowConfig:
    return row_of("small", row_record(**training))


def trained(plan: TrainingPlan) -> TrainedRun:
    """The run, heard by nobody."""
    torch.set_num_threads(1)
    return train(plan, lambda *_: None, lambda _: None)


class StoppedError(Exception):
    """What `stopping_after` stops a run with."""


def stopped_after(plan: TrainingPlan, step: int) -> None:
    """Train until this step is reported, and no further: as a kill there would leave it."""

    def reports(report: TrainingReport) -> None:
        if report.step == step:
            raise StoppedError

    try:
        train(plan, lambda *_: None, reports)
    except StoppedError:
        return
    raise AssertionError(f"there was no step {step}")


def tensors_of(run: Path, name: str = WEIGHTS) -> dict[str, Tensor]:
    return load_file(run / name)


def is_same_run(one: Path, other: Path) -> bool:
    """Whether weights, optimiser and random numbers are equal bit by bit."""
    for name in (WEIGHTS, CHECKPOINT):
        a, b = tensors_of(one, name), tensors_of(other, name)
        if a.keys() != b.keys() or not all(torch.equal(a[key], b[key]) for key in a):
            return False
    return True


def logged(run: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (run / LOG).read_text().splitlines()]


def logged_steps(run: Path) -> list[int]:
    return [line["step"] for line in logged(run) if not line["watched"]]
