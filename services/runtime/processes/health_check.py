"""The container health check: exit code 0 when healthy, else 1 and the reason.

    python -m services.runtime.processes.health_check              every process of this container that beats has beaten
    lately python -m services.runtime.processes.health_check 900          … within so many seconds
    python -m services.runtime.processes.health_check http://…     what answers there answers with success

**Conventions.** Of workers and sweeper it is not asked whether database and broker answer: starting them anew repairs
neither. Standard library only: it is run every half a minute.
"""

import os
import sys
from pathlib import Path
from urllib.request import ProxyHandler, build_opener

from services.runtime.processes.heartbeat_file import LiveProcess, live_processes

WITHIN_S = 120.0
ANSWER_S = 10.0


def silence(found: list[LiveProcess], within_s: float) -> str:
    """The processes that beat too long ago, in words; empty when all beat."""
    if not found:
        return "no process of this container beats"
    late = [f"{_name_of(one)} beat {one.age_s:.0f} s ago" for one in found if one.age_s > within_s]
    return "; ".join(late)


def _name_of(one: LiveProcess) -> str:
    return f"{one.part} of process {one.pid}" if one.part else f"process {one.pid}"


def refusal(url: str) -> str:
    """Why `url` gave no success; empty when it did. Asked directly, whatever proxy the environment names."""
    try:
        with build_opener(ProxyHandler({})).open(url, timeout=ANSWER_S):
            return ""
    except OSError as error:  # HTTPError is one
        return f"{url}: {error}"


def main() -> None:
    asked = sys.argv[1] if len(sys.argv) > 1 else str(WITHIN_S)
    if asked.startswith("http:"):
        wrong = refusal(asked)
    else:
        root = Path(os.environ.get("STONE_DATA_FOLDER", "stone-data")).expanduser()
        wrong = silence(live_processes(root), float(asked))
    if wrong:
        sys.exit(wrong)


if __name__ == "__main__":
    main()
