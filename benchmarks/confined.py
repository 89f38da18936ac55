"""What it costs that a recording is read in a confined child: `python -m benchmarks.confined [SECONDS]`.

**Conventions.** A simulated recording is looked at as registering does, in this process and in a child of it, in turns;
the least of the rounds counts, since what else runs only adds. The child's way includes the fork, the fences and the
parcel; kernels and plots are warm in both.
"""

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from services.ingest.apart import DESCRIPTORS, MEMORY_BYTES, SLACK_BYTES
from services.ingest.profiles import Profile
from services.ingest.received import Received, ReceivedFile
from services.ingest.seeing import _look
from services.ingest.warm import warm
from services.runtime.confined import Limits, confined
from simulator.options import SimulateOptions
from simulator.pipeline import simulate

ROUNDS = 7


def main(seconds: float) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bag = folder / "run.mcap"
        simulate(bag, SimulateOptions(seconds=seconds, seed=3))
        brought = Received("r", "s", "run.mcap", (ReceivedFile("f", "u", "run.mcap", "", bag),), folder, Profile())
        limits = Limits(
            memory_bytes=MEMORY_BYTES,
            mapped_bytes=SLACK_BYTES + 2 * bag.stat().st_size,
            answer_bytes=2**27,
            descriptors=DESCRIPTORS,
            folder=folder,
            file_bytes=2**40,
        )
        ways = {"in the process": lambda: _look(brought, folder, lambda *_: None)}
        ways["in a child"] = lambda: confined(ways["in the process"], limits)
        print(f"{bag.stat().st_size / 1e6:.0f} MB, {seconds:g} s of a full rig")
        report(ways)
        print(f"a child that does nothing: {1e3 * min(timed(lambda: confined(bytes)) for _ in range(20)):.1f} ms")


def report(ways: dict[str, Callable[[], bytes]]) -> None:
    warm()
    for way in ways.values():
        way()
    taken: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(ROUNDS):
        for name, way in ways.items():
            taken[name].append(timed(way))
    least = {name: min(seconds) for name, seconds in taken.items()}
    for name, seconds in least.items():
        print(f"{name}: {1e3 * seconds:.0f} ms")
    print(f"more in a child: {100 * (least['in a child'] / least['in the process'] - 1):.1f} %")


def timed(work: Callable[[], bytes]) -> float:
    begun = time.perf_counter()
    work()
    return time.perf_counter() - begun


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 20.0)
