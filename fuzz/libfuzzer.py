"""One target under libFuzzer, in a process of its own: `python -m fuzz.libfuzzer TARGET [libFuzzer options] CORPUS`."""

import sys
from contextlib import suppress

import atheris

import stone.scoring.bitplanes  # noqa: F401 # likewise
import stone_recordings.messages.lidar  # noqa: F401 # numba compiles bytecode and refuses the instrumented one
from stone_base.errors import StoneError

# isort: split

EXPORTED = (
    "stone_exports.files", "stone_files.archives", "stone_exports.tables", "stone_exports.sweeps",
    "stone_exports.frames", "stone_exports.labels", "stone_exports.labels", "stone_exports.cameras",
)  # fmt: skip
OF_FILES = (
    "stone_files.bag_fingerprint", "stone_files.calibration_bundle", "stone_files.joined_file",
)  # fmt: skip

with atheris.instrument_imports(
    include=[
        "stone_recordings",
        "stone_submissions",
        "services.eval",
        "services.ingest",
        "stone_datasets",
        *EXPORTED,
        *OF_FILES,
    ]
):
    from fuzz.limits import check
    from fuzz.targets import TARGETS, limits_of


def main() -> None:
    name = sys.argv.pop(1)
    target, limits = TARGETS[name], limits_of(name)
    with suppress(StoneError):
        target(b"")  # compiles before the first input
    atheris.Setup(sys.argv, lambda content: check(target, content, limits))
    atheris.Fuzz()


if __name__ == "__main__":
    main()
