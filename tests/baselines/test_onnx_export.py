"""`stone onnx`: what the file answers is what torch answers, it says what it is, and other rows are refused.

Catches alone a graph that an exporter's optimiser changed.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest
import torch
from typer.testing import CliRunner

from baselines.batch import Batch
from baselines.checkpoint import WeightsProvenance, write_weights
from baselines.layers.efficient_vit import relu_attention
from baselines.models.architectures import build_model
from baselines.models.column_net import ColumnNet
from baselines.models.column_net_program import ColumnNetProgram, column_cells, inputs_of, program_inputs
from baselines.models.occfusion_config import OccFusionConfig
from baselines.predict import loaded_run
from baselines.row_config import RowConfig
from baselines.run_folder import say_row
from stone_client.main import app
from tests.baselines.boxes_frame import IMAGE, SMALL, boxes_frame
from tests.baselines.recorded_run import ROW, made_run

BOXES_ROW = replace(
    ROW,
    inputs=replace(ROW.inputs, image_size_px=IMAGE, channels=("CAM_FRONT", "CAM_BACK")),
    model=replace(ROW.model, lattice=SMALL),
)


@pytest.fixture(scope="module")
def model(run: Path) -> ColumnNet:
    found = loaded_run(run, "cpu").predictor.model
    assert isinstance(found, ColumnNet)
    return found


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_run(tmp_path_factory.mktemp("onnx") / "run", BOXES_ROW)


@pytest.fixture(scope="module")
def written(run: Path) -> tuple[Path, dict[str, Any]]:
    """The file, and what the command says of it."""
    path = run.with_name("model.onnx")
    result = CliRunner().invoke(app, ["onnx", str(run), "-o", str(path), "--json"])
    assert result.exit_code == 0, (result.stderr, result.exception)
    return path, json.loads(result.stdout)


@pytest.fixture(scope="module")
def session(written: tuple[Path, dict[str, Any]]) -> Any:
    return onnxruntime.InferenceSession(written[0], providers=["CPUExecutionProvider"])


@pytest.fixture(scope="module")
def batch() -> Batch:
    return boxes_frame(SMALL)


def test_the_file_answers_what_torch_answers(model: ColumnNet, session: Any, batch: Batch) -> None:
    with torch.inference_mode():
        wanted = model(batch)
        fed = {name: value.numpy() for name, value in inputs_of(model, batch).items()}
    logits, log_temperature = session.run(["logits", "log_temperature"], fed)
    assert np.abs(logits - wanted.logits.numpy()).max() < 1e-4 * np.abs(logits).max()
    assert np.abs(log_temperature - wanted.log_temperature.numpy()).max() < 1e-4
    assert np.mean(logits.argmax(1) == wanted.logits.numpy().argmax(1)) >= 0.9999
    assert len(np.unique(logits.argmax(1))) == 4


def test_an_empty_frame_is_answered_too(model: ColumnNet, session: Any) -> None:
    nothing = program_inputs(model, 2, IMAGE)
    with torch.inference_mode():
        wanted, _ = ColumnNetProgram(model)(*nothing.values())
    logits, _ = session.run(None, {name: value.numpy() for name, value in nothing.items()})
    np.testing.assert_allclose(logits, wanted.numpy(), atol=1e-4 * np.abs(logits).max())


def test_the_file_says_what_it_is(written: tuple[Path, dict[str, Any]], session: Any) -> None:
    said = session.get_modelmeta().custom_metadata_map
    assert json.loads(said["stone.classes"]) == [
        "free", "traversable", "potentially_traversable", "non_traversable",
    ]  # fmt: skip
    assert json.loads(said["stone.lattice"])["shape"] == list(SMALL.shape)
    assert json.loads(said["stone.row"])["method"] == "Tiny"
    assert said["stone.data_sha256"] == "0" * 64
    assert list(json.loads(said["stone.inputs"])) == [one.name for one in session.get_inputs()]
    shapes = {one.name: one.shape for one in session.get_inputs()}
    assert shapes == {"maps": [1, 76, 32, 32], "base": [1, 32, 32], "images": [2, 3, 64, 64], "cells": [2, 2, 32, 32]}
    assert written[1]["inputs"] == shapes
    assert written[1]["size_bytes"] == written[0].stat().st_size


def test_cells_are_where_the_model_itself_looks(model: ColumnNet, batch: Batch) -> None:
    with torch.inference_mode():
        maps, _ = model.columns(batch)
        program = ColumnNetProgram(model)
        seen = list[torch.Tensor]()
        program.net.register_forward_pre_hook(lambda _net, given: seen.append(given[0]))
        program(*inputs_of(model, batch).values())
    torch.testing.assert_close(seen[0], maps)


def test_attention_without_a_key_is_0() -> None:
    nothing = torch.zeros(1, 4, 9)
    assert torch.equal(relu_attention(torch.ones(1, 4, 9), nothing, torch.ones(1, 4, 9)), nothing)


def test_without_cameras_there_are_no_cells(model: ColumnNet, batch: Batch) -> None:
    with pytest.raises(ValueError, match="there are none"):
        column_cells(model, replace(batch, cameras=None), torch.zeros(1, 2, 32, 32))
    alone = ColumnNet(replace(model.config, modality="L"))
    assert list(program_inputs(alone, 2, IMAGE)) == list(inputs_of(alone, batch)) == ["maps", "base"]


def test_other_architectures_are_refused_in_a_line(tmp_path: Path) -> None:
    other = OccFusionConfig(
        modality="C+L",
        resnet_depth=14,
        resnet_width=8,
        head_channels=8,
        pyramid_channels=16,
        level_channels=(8, 8, 8, 8),
    )
    row = RowConfig("other", "OccFusion", "a test", replace(ROW.inputs, modality="C+L"), other)
    say_row(tmp_path, row)
    write_weights(tmp_path, build_model(other), WeightsProvenance(row.as_json(), "0" * 64, "all", 1))
    result = CliRunner().invoke(app, ["onnx", str(tmp_path), "-o", str(tmp_path / "model.onnx")])
    assert (result.exit_code, len(result.stderr.splitlines())) == (1, 1)
    assert result.stderr.startswith("not_deployable: ")
