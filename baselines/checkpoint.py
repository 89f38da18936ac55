"""Checkpoints: the whole state of a run in one safetensors file, so that it can continue without a difference.

**Conventions.** Tensors `model.<name>`, `optimizer.<parameter>.<state>`, `rng.cpu`, `rng.cuda`; metadata is JSON:
config, step, position in the epoch, data hash. Nothing is pickled. A file appears by atomic rename, so a kill leaves
the previous file. `stone model predict` reads the weights alone (`write_weights`).
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from baselines.layers.resnet import ResNet
from stone.errors import Refused
from stone_files.atomic import atomic_file

# Errors of torch and safetensors for invalid files; `AttributeError` for a file without a dictionary.
UNREADABLE = (OSError, RuntimeError, SafetensorError, ValueError, EOFError, AttributeError, UnpicklingError)
CHECKPOINT, WEIGHTS = "checkpoint.safetensors", "weights.safetensors"
SAID = "stone"


@dataclass(frozen=True)
class Position:
    """The progress of a run: optimiser steps, and frames of this epoch drawn by each process."""

    step: int = 0
    epoch: int = 0
    drawn: int = 0


@dataclass(frozen=True)
class WeightsProvenance:
    """The origin of weights: the row's config as JSON, the data's hash, the metric, the best validation score."""

    config: str
    data_sha256: str
    metric: str
    frames: int
    processes: int = 1
    position: Position = Position()
    best_miou: float | None = None


def write_checkpoint(
    folder: Path, model: nn.Module, optimizer: torch.optim.Optimizer, provenance: WeightsProvenance
) -> None:
    """Replace the run's checkpoint."""
    tensors = {f"model.{name}": value for name, value in model.state_dict().items()}
    tensors |= _optimizer_tensors(model, optimizer)
    tensors["rng.cpu"] = torch.get_rng_state()
    if torch.cuda.is_available():
        tensors["rng.cuda"] = torch.cuda.get_rng_state()
    _write(folder / CHECKPOINT, tensors, provenance)


def read_checkpoint(folder: Path, model: nn.Module, optimizer: torch.optim.Optimizer) -> WeightsProvenance:
    """Restore model, optimiser and random numbers from the checkpoint. Raises `bad_run`."""
    path = folder / CHECKPOINT
    provenance = provenance_of(path)
    tensors = load_file(path)
    _load_model(folder, model, {name[6:]: value for name, value in tensors.items() if name.startswith("model.")})
    for name, parameter in model.named_parameters():
        start = f"optimizer.{name}."
        states = {key[len(start) :]: value for key, value in tensors.items() if key.startswith(start)}
        if states:
            moved = {key: value.to(parameter.device) if value.dim() else value for key, value in states.items()}
            optimizer.state[parameter] = moved
    torch.set_rng_state(tensors["rng.cpu"])
    if "rng.cuda" in tensors and torch.cuda.is_available():
        torch.cuda.set_rng_state(tensors["rng.cuda"])
    return provenance


def write_weights(folder: Path, model: nn.Module, provenance: WeightsProvenance) -> None:
    """Replace the run's weights."""
    _write(folder / WEIGHTS, model.state_dict(), provenance)


def read_weights(folder: Path, model: nn.Module) -> WeightsProvenance:
    """Load the weights into the model. Raises `bad_run`."""
    provenance = provenance_of(folder / WEIGHTS)
    _load_model(folder, model, load_file(folder / WEIGHTS))
    return provenance


def provenance_of(path: Path) -> WeightsProvenance:
    """Return the metadata of the file. Raises `bad_run`."""
    if not path.is_file():
        raise Refused(
            "bad_run", f"{path.parent}: there is no {path.name}; did the run end before its first checkpoint?"
        )
    try:
        with safe_open(path, "pt") as file:
            metadata = json.loads((file.metadata() or {})[SAID])
        return WeightsProvenance(**{**metadata, "position": Position(**metadata["position"])})
    except (SafetensorError, KeyError, TypeError, ValueError) as error:
        raise Refused("bad_run", f"{path.parent}: {path.name} is not a file of a run") from error


def load_backbone(model: nn.Module, path: Path) -> None:
    """Load pretrained weights of the model's image backbone, from a safetensors or torch file with torchvision's keys.

    A classifier in it is ignored. Raises `bad_run` if a weight of the backbone is missing or has another shape, if the
    file contains anything but tensors, or if the model has no such backbone.
    """
    backbone = next((part for part in model.modules() if isinstance(part, ResNet)), None)
    if backbone is None:
        raise Refused("bad_run", f"{path.parent}: {path.name} contains an image backbone, but this row has none")
    try:
        tensors = load_file(path) if path.suffix == ".safetensors" else torch.load(path, weights_only=True)
        backbone.load_pretrained({name: value for name, value in tensors.items() if isinstance(value, Tensor)})
    except UNREADABLE as error:
        why = (str(error).splitlines() or [type(error).__name__])[0]
        raise Refused("bad_run", f"{path.parent}: {path.name} lacks the weights: {why}") from error


def _optimizer_tensors(model: nn.Module, optimizer: torch.optim.Optimizer) -> dict[str, Tensor]:
    return {
        f"optimizer.{name}.{key}": value
        for name, parameter in model.named_parameters()
        for key, value in optimizer.state.get(parameter, {}).items()
    }


def _load_model(folder: Path, model: nn.Module, tensors: Mapping[str, Tensor]) -> None:
    try:
        model.load_state_dict(dict(tensors))
    except RuntimeError as error:
        why = str(error).splitlines()[1].strip() if "\n" in str(error) else str(error)
        raise Refused("bad_run", f"{folder}: its weights belong to another model: {why[:200]}") from error


def _write(path: Path, tensors: Mapping[str, Tensor], provenance: WeightsProvenance) -> None:
    metadata: dict[str, Any] = asdict(provenance)
    whole = {name: value.detach().contiguous().clone() for name, value in tensors.items()}
    with atomic_file(path) as staging:
        save_file(whole, staging, {SAID: json.dumps(metadata, sort_keys=True)})
