"""A check that the libraries of models are installed; otherwise one line states the remedy."""

from collections.abc import Iterator
from contextlib import contextmanager

from stone_base.errors import Refused

NEEDED = ("torch", "safetensors", "tensorboard", "onnx", "onnxscript")


@contextmanager
def torch_needed() -> Iterator[None]:
    """Guard imports of `baselines`. Raises `no_torch` if a required library is missing."""
    try:
        yield
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        if missing not in NEEDED:
            raise
        raise Refused(
            "no_torch",
            f"{missing} is not installed; run `make baselines`, then .venv-baselines/bin/stone with the same arguments",
        ) from error
