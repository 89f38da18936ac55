"""Compile every kernel into numba's cache, and compute code versions: `python deploy/warm_kernels.py`.

**Conventions.** By what the platform's own processes call before they fork, and so with the types that they call with.
Labelling is two thirds of it, so it has a process of its own; the others share one. What is in the cache is not
compiled again.
"""

import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from importlib import import_module
from multiprocessing import get_context

PARTS = (
    ("services.labeler.imports.kernel_warmup:warm_imports",),
    (
        "services.ingest.kernel_warmup:warm",
        "services.eval.kernel_warmup:warm",
        "simulator.kernel_warmup:warm",
        "stone_local.kernel_warmup:warm",
    ),
)


def main() -> None:
    with ProcessPoolExecutor(len(PARTS), get_context("spawn")) as pool:
        compiled = pool.map(warm, PARTS)
        import_module("services.runtime.code_version")  # which parses the sources and keeps their digests
        list(compiled)


def warm(part: Sequence[str]) -> None:
    for place in part:
        module, _, name = place.partition(":")
        getattr(import_module(module), name)()
        sys.stdout.write(f"{module}: compiled\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
