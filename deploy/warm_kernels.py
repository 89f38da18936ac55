"""Compile every kernel into numba's cache, and compute code versions: `python deploy/warm_kernels.py`.

**Conventions.** Kernels are compiled by the functions that the platform's processes call before they fork, and so for
the same types; the simulator does not fork and is called here. Labelling takes two thirds of the time, so it has a
process of its own; the others share one. Kernels in the cache are not compiled again.
"""

import sys
from concurrent.futures import ProcessPoolExecutor
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory


def main() -> None:
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        compiled = [pool.submit(warm_labelling), pool.submit(warm_others)]
        import_module("services.runtime.code_version")  # parses the sources and caches their digests
        for part in compiled:
            part.result()


def warm_labelling() -> None:
    from services.labeler.imports.kernel_warmup import warm_imports

    warm_imports()
    report("labelling")


def warm_others() -> None:
    from services.eval.kernel_warmup import warm as warm_eval
    from services.ingest.kernel_warmup import warm as warm_ingest
    from simulator.options import SimulateOptions
    from simulator.pipeline import simulate

    warm_ingest()
    report("ingest")
    warm_eval()
    report("eval")
    small = SimulateOptions(seconds=0.2, channels=16, columns=90, camera_width_px=64, world_width_m=40.0)
    with TemporaryDirectory(prefix="stone-warmup-") as folder:
        simulate(Path(folder) / "run.mcap", small)
    report("simulator")


def report(part: str) -> None:
    sys.stdout.write(f"{part}: compiled\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
