"""Validates archives one by one, each in a confined child of a fresh process, and says what that cost.

**Conventions.** Run as `python -m tests.services.eval.measuring MANIFEST HONEST`: reads a path a line, answers a line
of JSON each: {"verdict", "cpu_s", "growth_bytes"} or {"refused": code}. The limits are the claim: what asks for more
than 64 MiB of address space or a second of processor is ended. Growth is the kernel's peak of what is resident.
"""

import json
import resource
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

from services.runtime.sandbox import SandboxLimits, sandboxed
from services.runtime.telemetry.log_lines import speak_json
from stone.errors import StoneError
from stone_submissions.validation import validate

LIMITS = SandboxLimits(memory_bytes=64 * 2**20, cpu_s=1)
CLEAR_REFS, RESET_PEAK, STATUS = Path("/proc/self/clear_refs"), "5", Path("/proc/self/status")  # man 5 proc


def resident() -> dict[str, int]:
    lines = dict(line.split(":", 1) for line in STATUS.read_text().splitlines())
    return {name: int(lines[name].split()[0]) * 1024 for name in ("VmRSS", "VmHWM")}


def measured(path: Path, manifest: Path) -> bytes:
    """In the child."""
    before = resident()["VmRSS"]
    verdict = validate(path, manifest)
    usage = resource.getrusage(resource.RUSAGE_SELF)
    cost = {"cpu_s": usage.ru_utime + usage.ru_stime, "growth_bytes": resident()["VmHWM"] - before}
    return json.dumps({"verdict": verdict.as_record(), **cost}).encode()


def main() -> None:
    speak_json()  # to stderr: answers are on stdout
    manifest, honest = map(Path, sys.argv[1:])
    validate(honest, manifest)  # what is compiled or imported once is nobody's growth
    for line in sys.stdin:
        path = Path(line.rstrip("\n"))
        try:
            CLEAR_REFS.write_text(RESET_PEAK)
            limits = replace(LIMITS, reads=(path, manifest))
            answer = sandboxed(partial(measured, path, manifest), limits)
        except StoneError as error:
            answer = json.dumps({"refused": error.code}).encode()
        sys.stdout.write(answer.decode() + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
