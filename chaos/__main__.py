"""The kill suite: `python -m chaos [--rounds 50] [--only worker …] [--seed N] [--minutes M] [--folder DIR]`.

It exits with 1 if anything was lost, doubled or different, or if a kind never hit running work, which proves nothing.
The folder keeps the data of violations, with the command that repeats the round.
"""

import argparse
import os
import random
import sys
import tempfile
import time
from hashlib import sha256
from pathlib import Path

from rich.console import Console

from chaos.inputs import simulated
from chaos.kinds import KINDS
from chaos.result_hashes import RunArtefacts
from chaos.rounds import RoundSeries, Suite, play
from chaos.table import table_of

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = (
    "stone", "stone_base", "stone_files", "stone_recordings", "stone_submissions", "stone_exports",
    "stone_datasets", "services",
    "simulator", "stone_client", "stone_local", "api",
)  # fmt: skip
CONSOLE = Console(highlight=False, markup=False, soft_wrap=True)


def main() -> int:
    options = _options()
    os.environ["STONE_CONFIG_HOME"] = str(options.folder / "home")
    CONSOLE.print(f"seed {options.seed}, folder {options.folder}")
    begun_s, code = time.monotonic(), _code()
    inputs = simulated(options.folder / "inputs")
    until_s = begun_s + options.minutes * 60.0
    suite = Suite(options.seed, options.rounds, options.folder, inputs, until_s, CONSOLE.print)
    played: list[RoundSeries] = []
    made: RunArtefacts | None = None
    for kind in KINDS:
        if not options.only or kind.name in options.only:
            played.append(play(suite, kind, made))
            made = played[-1].made
    Console(width=max(Console().width, 130)).print(table_of(played, options.seed, time.monotonic() - begun_s))
    if code != _code():
        CONSOLE.print("the code changed during the run, and restarted processes ran the new code: the result is void")
        return 1
    return 0 if all(series.is_proven for series in played) else 1


def _code() -> str:
    """Return the sha256 of the project's sources: a platform of two versions fails for other reasons."""
    whole = sha256()
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            whole.update(path.read_bytes())
    return whole.hexdigest()


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m chaos", description=__doc__)
    parser.add_argument("--rounds", type=int, default=50, help="of each kind")
    parser.add_argument("--only", nargs="+", choices=[kind.name for kind in KINDS], default=[])
    parser.add_argument("--seed", type=int, default=random.SystemRandom().randrange(2**31))
    parser.add_argument("--minutes", type=float, default=60.0, help="start no round after this time")
    parser.add_argument("--folder", type=Path, help="folder of the rounds (default: a temporary folder)")
    options = parser.parse_args()
    options.folder = (options.folder or Path(tempfile.mkdtemp(prefix="stone-chaos-"))).absolute()
    return options


if __name__ == "__main__":
    sys.exit(main())
