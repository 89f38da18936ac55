"""One target under libFuzzer, in a process of its own: `python -m fuzz.fuzzing TARGET [libFuzzer options] CORPUS`."""

import sys

import atheris

import services.ingest.messages.point_kernel  # noqa: F401 # numba compiles bytecode and refuses the instrumented one
import stone.bitplanes  # noqa: F401 # likewise

# isort: split

EXPORTED = ("client.spans", "client.tar_places", "client.exported_sweeps")

with atheris.instrument_imports(include=["services.ingest", "services.eval", *EXPORTED]):
    from fuzz.limits import check
    from fuzz.targets import TARGETS


def main() -> None:
    name = sys.argv.pop(1)
    target = TARGETS[name]
    atheris.Setup(sys.argv, lambda content: check(target, content))
    atheris.Fuzz()


if __name__ == "__main__":
    main()
