"""The probe of workers and sweeper: exit code 0 when every process of this container that beats has beaten lately.

    python -m services.runtime.processes.alive [SECONDS]

**Conventions.** Whether database and broker answer is not asked: restarting a worker mends neither.
"""

import os
import sys
from pathlib import Path

from services.runtime.processes.pulse import Heard, heard

WITHIN_S = 120.0


def verdict(found: list[Heard], within_s: float) -> str:
    """What is wrong; empty when nothing is."""
    if not found:
        return "no process of this container beats"
    late = [f"process {one.pid} beat {one.age_s:.0f} s ago" for one in found if one.age_s > within_s]
    return "; ".join(late)


def main() -> None:
    within_s = float(sys.argv[1]) if len(sys.argv) > 1 else WITHIN_S
    root = Path(os.environ.get("STONE_DATA_FOLDER", "stone-data")).expanduser()
    wrong = verdict(heard(root), within_s)
    if wrong:
        sys.exit(wrong)


if __name__ == "__main__":
    main()
