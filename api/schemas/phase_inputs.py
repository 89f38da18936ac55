"""Inputs of a phase over the wire: the sensor data that participants predict from."""

from datetime import datetime
from typing import Any

from api.schemas.base import SHA256_EXAMPLE, Answer, example

INPUT_EXAMPLE: dict[str, Any] = {
    "name": "n-forest-07",
    "files": 13216,
    "size_bytes": 41003421,
    "tar_bytes": 48210432,
    "tar_sha256": SHA256_EXAMPLE,
    "created_at": "2026-05-03T10:33:40Z",
}


class PhaseInputItem(Answer):
    """The inputs of one sequence; its tar is at `inputs/{name}.tar`."""

    model_config = example(**INPUT_EXAMPLE)

    name: str
    files: int
    size_bytes: int
    tar_bytes: int
    tar_sha256: str
    created_at: datetime
