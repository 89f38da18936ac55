"""Frames as tensors for torch's `DataLoader`; the only module here that imports torch."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch.utils.data import Dataset

from stone_client.devkit.frame import Frame


class FrameTensors(Dataset[dict[str, Any]]):  # type: ignore[misc]
    """The values of `read(frame)`, arrays as tensors; other values stay as they are."""

    def __init__(self, frames: Sequence[Frame], read: Callable[[Frame], Mapping[str, Any]]) -> None:
        self.frames, self.read = frames, read

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index: int) -> dict[str, Any]:
        arrays = self.read(self.frames[index])
        return {key: torch.tensor(value) if isinstance(value, np.ndarray) else value for key, value in arrays.items()}
