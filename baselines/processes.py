"""Training by several processes under `torchrun`: the rank and device of this process."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from torch import distributed

from stone.errors import Refused


@dataclass(frozen=True)
class ProcessShare:
    """`rank` of `world` processes; only the first writes."""

    rank: int
    world: int
    device: torch.device

    @property
    def is_first(self) -> bool:
        return self.rank == 0

    def wait(self) -> None:
        """Wait until all processes have called this."""
        if self.world > 1:
            distributed.barrier()


@contextmanager
def joined_processes(device: str) -> Iterator[ProcessShare]:
    """Yield this process's share of its `torchrun`, or a share alone. Raises `no_accelerator`."""
    rank, world = int(os.environ.get("RANK", "0")), int(os.environ.get("WORLD_SIZE", "1"))
    own = usable_device(device, int(os.environ.get("LOCAL_RANK", "0")))
    if world == 1:
        yield ProcessShare(rank, world, own)
        return
    distributed.init_process_group("nccl" if device == "cuda" else "gloo")
    try:
        yield ProcessShare(rank, world, own)
    finally:
        distributed.destroy_process_group()


def usable_device(name: str, index: int = 0) -> torch.device:
    """Return the CPU, or the GPU with the index `index`. Raises `no_accelerator`."""
    if name != "cuda":
        return torch.device(name)
    if index >= torch.cuda.device_count():
        raise Refused(
            "no_accelerator",
            f"cuda:{index} cannot be used here by torch {torch.__version__}: use --device cpu, or install the "
            "torch that matches the machine's driver",
        )
    return torch.device(name, index)
