"""How much memory a process takes to read or to refuse a recording, or to recover it."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
GROWTH_LIMIT_BYTES = 64 * 1024 * 1024
GROWTH = """
import resource, sys
from pathlib import Path
from stone_recordings.bags.recovery.recovery import recover
from stone_recordings.report.inspection import inspect
from stone_recordings.bags.bag import open_bag
from stone.errors import StoneError
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
said, bag, *out = "read", *map(Path, sys.argv[1:])
try:
    if out:
        said = recover(bag, out[0]).messages
    else:
        inspect(bag)
        with open_bag(bag) as opened:
            for topic in opened.topics:
                for message in opened.messages(topic.name):
                    len(message.payload)
except StoneError as error:
    said = error.code
sys.stdout.write(f"{said} {(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024}")
"""


def growth_of(path: Path, *out: Path) -> tuple[str, int]:
    """The refusal's code, "read", or the number of messages recovered to `out`; and how many bytes it took."""
    command = [sys.executable, "-c", GROWTH, str(path), *map(str, out)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=True)
    said, growth = done.stdout.split()
    return said, int(growth)
