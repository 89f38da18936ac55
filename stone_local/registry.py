"""The platform's commands, as the `stone` command finds them (`stone_client/platform_part.py`)."""

from collections.abc import Callable

import typer

from stone_local.commands.baseline import baseline
from stone_local.commands.calibration import calibration
from stone_local.commands.check import check
from stone_local.commands.demo import demo
from stone_local.commands.export import export
from stone_local.commands.inspect import inspect
from stone_local.commands.label import label
from stone_local.commands.label_sets import label_sets
from stone_local.commands.models.onnx import onnx
from stone_local.commands.models.predict import predict
from stone_local.commands.models.train import train
from stone_local.commands.recover import recover
from stone_local.commands.score import score
from stone_local.commands.serve import serve
from stone_local.commands.simulate import simulate

COMMANDS: dict[str, tuple[Callable[..., None], ...]] = {
    "On this machine": (simulate, inspect, recover, label, export, baseline, score, check, demo),
    "With a server": (serve,),
    "Models": (train, predict, onnx),
}
GROUPS: dict[str, tuple[str, typer.Typer]] = {
    "calibration": ("On this machine", calibration),
    "label-sets": ("On this machine", label_sets),
}
