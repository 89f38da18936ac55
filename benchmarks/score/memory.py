"""Peak memory of a process that only scores: `python -m benchmarks.score.memory ZIP PACK`."""

import re
import sys
from pathlib import Path

from services.eval.examination import count_range, sampled_tokens
from services.eval.truth_pack import TruthPack
from stone_submissions.archive import open_submission

THREADS = 2


def main() -> None:
    zip_path, pack_path = map(Path, sys.argv[1:])
    with TruthPack(pack_path) as pack, open_submission(zip_path, pack.tokens, pack.grid) as submission:
        sampled = sampled_tokens(pack.tokens)
        counted = count_range(submission, pack.tokens, pack.planes_of, sampled=sampled, threads=THREADS)
    if submission.problems or counted.problems:
        raise SystemExit("the submission was refused: the benchmark is void")
    print(high_water_bytes())


def high_water_bytes() -> int:
    """Return the peak of this process's own memory; `getrusage` would return the parent's if that was more."""
    status = Path("/proc/self/status").read_text("ascii")
    return 1024 * int(re.findall(r"VmHWM:\s+(\d+) kB", status)[0])


if __name__ == "__main__":
    main()
