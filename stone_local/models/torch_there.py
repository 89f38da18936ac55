"""Whether what models need is installed: else one line says what to do."""

from collections.abc import Iterator
from contextlib import contextmanager

from stone_local.errors import NoTorchError

NEEDED = ("torch", "safetensors", "tensorboard", "onnx", "onnxscript")


@contextmanager
def torch_needed() -> Iterator[None]:
    """Around imports of `baselines`. Raises `NoTorchError` where what they need is not there."""
    try:
        yield
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        if missing not in NEEDED:
            raise
        raise NoTorchError(missing) from error
