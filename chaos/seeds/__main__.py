"""Play histories of jobs from seeds: `python -m chaos.seeds [--seeds 0..100] [--minutes 10] [--processes 2]`.

Workers, sweepers, an owner, a broker and database faults take turns, drawn from the seed. The job code is the
platform's, the clock is virtual. The exit status is 1 if a history loses, doubles or never ends something. The line
of a failed seed names the fault and the command that plays the history again. After the repair, add the seed to
`PAST` in `tests/chaos/seeds/test_histories.py`, where every test run plays it again.
"""

import argparse
import gc
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from itertools import count
from multiprocessing import get_context

from rich.console import Console

from chaos.seeds.histories import History, play

AT_ONCE = 20
REPORTED_EVERY_S = 60.0
CONSOLE = Console(highlight=False, markup=False, soft_wrap=True)


def main() -> int:
    options = _options()
    begun_s = reported_s = time.monotonic()
    until_s = begun_s + options.minutes * 60.0
    histories = steps = broken = 0
    with ProcessPoolExecutor(options.processes, get_context("forkserver"), gc.freeze) as pool:
        for played in _played(pool, options, until_s):
            histories, steps = histories + 1, steps + played.steps
            if played.violation:
                broken += 1
                again = f"python -m chaos.seeds --seeds {played.seed}..{played.seed + 1}"
                CONSOLE.print(f"seed {played.seed}, step {played.steps}: {played.violation} ({again})")
            if time.monotonic() - reported_s > REPORTED_EVERY_S:
                reported_s = time.monotonic()
                CONSOLE.print(_summary(histories, steps, broken, reported_s - begun_s))
    CONSOLE.print(_summary(histories, steps, broken, time.monotonic() - begun_s))
    return 1 if broken or not histories else 0


def _summary(histories: int, steps: int, broken: int, passed_s: float) -> str:
    minutes = passed_s / 60.0
    return (
        f"{histories} histories, {steps} steps in {minutes:.1f} minutes: {histories / minutes:.0f} and "
        f"{steps / minutes:.0f} a minute, {broken} broken"
    )


def _played(pool: ProcessPoolExecutor, options: argparse.Namespace, until_s: float) -> Iterator[History]:
    first, last = options.seeds
    for begin in count(first, AT_ONCE * options.processes):
        seeds = range(begin, min(begin + AT_ONCE * options.processes, last))
        if not seeds or time.monotonic() > until_s:
            return
        yield from pool.map(play, seeds)


def _seeds(text: str) -> tuple[int, int]:
    first, _, last = text.partition("..")
    return int(first), int(last)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m chaos.seeds", description=__doc__)
    parser.add_argument("--seeds", type=_seeds, default=(0, 2**31), help="A..B: seeds from A to B - 1 (default: all)")
    parser.add_argument("--minutes", type=float, default=10.0, help="minutes until the last seeds start (default: 10)")
    parser.add_argument("--processes", type=int, default=2, help="number of processes (default: 2)")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
