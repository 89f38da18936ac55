"""What training and predicting refuse."""

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

from stone.errors import StoneError


class BadRowError(StoneError):
    """The configuration of a row cannot be read, or says something impossible."""

    code: ClassVar[str] = "bad_row"

    def __init__(self, name: str, why: str, known: Sequence[str] = ()) -> None:
        hint = f"; the rows that are there: {', '.join(known)}, or a path of a YAML file" if known else ""
        super().__init__(f"row {name!r}: {why}{hint}")


class NothingToTrainOnError(StoneError):
    """The exports have no frame with labels."""

    code: ClassVar[str] = "nothing_to_train_on"

    def __init__(self, exports: Sequence[Path]) -> None:
        named = ", ".join(str(path) for path in exports[:3])
        super().__init__(
            f"{named} hold no frame with labels: expected are exports of `stone export --format nuscenes`, or inputs "
            "beside the tars of a dataset version (was an export of format inputs given alone?)"
        )


class TooFewFramesError(StoneError):
    """An epoch has fewer frames than one step takes."""

    code: ClassVar[str] = "too_few_frames"

    def __init__(self, frames: int, a_step: int) -> None:
        super().__init__(
            f"each process has {frames} frames to train on, a step takes {a_step}: lower --batch, --accumulate or "
            "--stride, or give more exports"
        )


class SensorMissingError(StoneError):
    """A frame lacks a sensor that the row uses."""

    code: ClassVar[str] = "sensor_missing"

    def __init__(self, token: str, sequence: str, sensor: str, modality: str) -> None:
        super().__init__(
            f"frame {token} of {sequence} has no {sensor}, and the row is of modality {modality}: give a row of the "
            "sensors that are there, or leave this sequence out"
        )


class RunExistsError(StoneError):
    """The folder for a new run holds another run."""

    code: ClassVar[str] = "run_exists"

    def __init__(self, folder: Path) -> None:
        super().__init__(f"{folder} holds a run: continue it with --resume, or name another folder")


class BadRunError(StoneError):
    """The folder is not a run that this release can resume or predict from."""

    code: ClassVar[str] = "bad_run"

    def __init__(self, folder: Path, why: str) -> None:
        super().__init__(f"{folder}: {why}")


class NotDeployableError(StoneError):
    """A row cannot be written as an ONNX file."""

    code: ClassVar[str] = "not_deployable"

    def __init__(self, method: str, architecture: str, able: Sequence[str]) -> None:
        super().__init__(
            f"{method} is of architecture {architecture}, whose shapes follow each frame, and cannot be written as "
            f"ONNX; of those that there are, this one can: {', '.join(able)}"
        )


class TrainingDivergedError(StoneError):
    """A loss is NaN or infinite."""

    code: ClassVar[str] = "training_diverged"

    def __init__(self, step: int, terms: dict[str, float], rate: float) -> None:
        said = ", ".join(f"{name} {value:.3g}" for name, value in terms.items())
        super().__init__(
            f"step {step}: the losses are {said} at a learning rate of {rate:.2e}; lower learning_rate or "
            "clip_norm, or train in float32 (--precision float32); the last checkpoint is intact"
        )


class NoAcceleratorError(StoneError):
    """The requested device is not available."""

    code: ClassVar[str] = "no_accelerator"

    def __init__(self, device: str, version: str) -> None:
        super().__init__(
            f"{device} cannot be used here by torch {version}: use --device cpu, or install the torch that "
            "matches the machine's driver"
        )


class TooLittleMemoryError(StoneError):
    """The device's memory does not hold a step."""

    code: ClassVar[str] = "too_little_memory"

    def __init__(self, device: str, batch: int) -> None:
        super().__init__(
            f"{device} has too little memory for a step of {batch} frames: lower --batch, use "
            "--checkpoint-gradients, or train a smaller row"
        )
