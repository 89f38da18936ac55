"""A trained row as one ONNX file, for a robot's own runtime.

**Conventions.** The file contains all learned layers; sorting points into columns and pixels into cells is outside it
(`baselines/models/column_net_program.py`). Float32, static shapes, one frame at a time. Its metadata are `stone.row`
(the configuration), `stone.classes`, `stone.grid`, `stone.lattice`, `stone.inputs`, `stone.data_sha256`, `stone.steps`.
"""

import json
import logging
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from hashlib import file_digest
from pathlib import Path
from typing import cast

import torch
from torch import Tensor

from baselines.models.column_net import ColumnNet
from baselines.models.column_net_program import ColumnNetProgram, program_inputs
from baselines.predict import LoadedRun, loaded_run
from stone.errors import Refused
from stone_files.atomic import atomic_file

CLASSES = ("free", "traversable", "potentially_traversable", "non_traversable")
OUTPUTS = ("logits", "log_temperature")
MEANINGS = {
    "maps": "float32 (1, C, X, Y): ColumnNet.geometry(batch).maps",
    "base": "int64 (1, X, Y): ColumnNet.geometry(batch).base",
    "images": "float32 (N, 3, H, W): undistorted, normalised by ImageNet's mean and deviation, in the row's channels",
    "cells": "int64 (N, 2, X, Y): column_cells(model, batch, surface_m)",
    "logits": "float32 (1, 4, X, Y, Z): the largest is the class",
    "log_temperature": "float32 (1, 1, X, Y, Z): softmax(logits / exp(log_temperature)) are probabilities",
}


@dataclass(frozen=True)
class WrittenOnnx:
    """A written file, and the shapes of its inputs."""

    output: str
    size_bytes: int
    sha256: str
    method: str
    steps: int
    inputs: Mapping[str, tuple[int, ...]]


def write_onnx(run: Path, output: Path) -> WrittenOnnx:
    """Write the run's network. Raises `bad_run`, `bad_row`, `not_deployable`, `output_exists`."""
    loaded = loaded_run(run, "cpu")
    model = loaded.predictor.model
    if not isinstance(model, ColumnNet):
        raise Refused(
            "not_deployable",
            f"{loaded.row.method} has the architecture {loaded.row.model.architecture}, whose shapes depend on the "
            f"frame, so it cannot be written as ONNX; only {', '.join(['column_net'])} can",
        )
    inputs = program_inputs(model, len(loaded.row.inputs.channels), loaded.row.inputs.image_size_px)
    with atomic_file(output) as staging:
        _export(model, inputs, _metadata(loaded, inputs), staging)
        with staging.open("rb") as file:
            digest = file_digest(file, "sha256").hexdigest()
        size_bytes = staging.stat().st_size
    shapes = {name: tuple(value.shape) for name, value in inputs.items()}
    return WrittenOnnx(str(output), size_bytes, digest, loaded.row.method, loaded.provenance.position.step, shapes)


def _export(model: ColumnNet, inputs: Mapping[str, Tensor], metadata: Mapping[str, str], path: Path) -> None:
    with _quiet_exporter():
        program = cast(
            "torch.onnx.ONNXProgram",  # the type that torch's graph exporter always returns
            torch.onnx.export(
                ColumnNetProgram(model).eval(),
                tuple(inputs.values()),
                input_names=list(inputs),
                output_names=list(OUTPUTS),
                dynamo=True,
                verbose=False,
            ),
        )
    program.model.metadata_props.update(metadata)
    program.save(str(path), external_data=False)


def _metadata(loaded: LoadedRun, inputs: Mapping[str, Tensor]) -> dict[str, str]:
    return {
        "stone.row": loaded.row.as_json(),
        "stone.classes": json.dumps(CLASSES),
        "stone.grid": json.dumps(loaded.row.label_grid.as_record()),
        "stone.lattice": json.dumps(asdict(loaded.predictor.model.lattice)),
        "stone.inputs": json.dumps({name: MEANINGS[name] for name in inputs}),
        "stone.outputs": json.dumps({name: MEANINGS[name] for name in OUTPUTS}),
        "stone.data_sha256": loaded.provenance.data_sha256,
        "stone.steps": str(loaded.provenance.position.step),
    }


@contextmanager
def _quiet_exporter() -> Iterator[None]:
    """Suppress the exporter's warnings about unneeded libraries and its own deprecated calls."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)
