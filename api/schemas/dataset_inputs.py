"""Inputs of a dataset version over the wire: the sensor data that is trained on beside its labels."""

from datetime import datetime
from typing import Any

from api.schemas.base import SHA256_EXAMPLE, Answer, example
from api.schemas.datasets import OpenPart
from services.domain.datasets.input_jobs import InputState

DATASET_INPUT_EXAMPLE: dict[str, Any] = {
    "name": "n-forest-07",
    "split": "train",
    "state": "ready",
    "files": 13216,
    "size_bytes": 41003421,
    "tar_bytes": 48210432,
    "tar_sha256": SHA256_EXAMPLE,
    "created_at": "2026-05-03T10:33:40Z",
}


class DatasetInputItem(Answer):
    """The inputs of a sequence of train or val; its tar is at `inputs/{name}.tar` once the state is `ready`.

    `missing`: being made, or to be made when an administrator asks. `lost`: sequence or recording were deleted before,
    so there will be none. Of both, sizes are 0 and the sha256 is ''.
    """

    model_config = example(**DATASET_INPUT_EXAMPLE)

    name: str
    split: OpenPart
    state: InputState
    files: int
    size_bytes: int
    tar_bytes: int
    tar_sha256: str
    created_at: datetime | None
