"""How much memory a process takes to refuse a recording."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
GROWTH_LIMIT_BYTES = 64 * 1024 * 1024
GROWTH = """
import resource, sys
from pathlib import Path
from stone_recordings.report.inspection import inspect
from stone_recordings.bags.bag import open_bag
from stone.errors import StoneError
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
try:
    inspect(Path(sys.argv[1]))
    sys.exit("accepted")
except StoneError as error:
    sys.stdout.write(f"{error.code} {(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024}")
"""


def growth_of(path: Path) -> tuple[str, int]:
    """The refusal's code, and how many bytes it took."""
    command = [sys.executable, "-c", GROWTH, str(path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=True)
    code, growth = done.stdout.split()
    return code, int(growth)
