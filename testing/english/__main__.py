"""Print each sentence that breaks a rule of docs/style.md: `python -m testing.english [PATH…] [--counts]`.

PATH is a file or a folder; the default is the whole checkout. `--counts` prints a table of counts by rule and folder
instead. `--sample N [--seed S]` prints N sentences for a reader to judge, drawn by stratum. The exit code is 1 if there
are hits.
"""

import argparse
import sys
from collections import Counter
from collections.abc import Iterable, Iterator

from testing.english.exceptions import EXCEPTIONS, without_exceptions
from testing.english.rules import RULES, Hit, hits
from testing.english.sample import draw
from testing.english.texts import ROOT, texts_of, tracked

MOST_FOLDERS = 8


def main() -> int:
    """Run the command and return its exit code."""
    parser = argparse.ArgumentParser(prog="python -m testing.english", description=__doc__)
    parser.add_argument("paths", nargs="*", help="Files or folders to read (default: the whole checkout)")
    parser.add_argument("--counts", action="store_true", help="Print counts by rule and folder")
    parser.add_argument("--sample", type=int, metavar="N", help="Print N sentences, drawn by stratum")
    parser.add_argument("--seed", type=int, default=0, help="Seed of the sample (default: 0)")
    options = parser.parse_args()
    if not (ROOT / ".git").exists():
        _write(["not a git checkout, so the project's own files are unknown: nothing is checked"])
        return 0
    texts = [text for path in _chosen(options.paths) for text in texts_of(path)]
    if options.sample:
        drawn = draw(texts, options.sample, options.seed)
        _write(f"{stratum}\t{text.path}:{text.line}\t{sentence}" for stratum, text, sentence in drawn)
        return 0
    remaining, unused = without_exceptions([hit for text in texts for hit in hits(text)])
    if options.paths:
        unused = []
    if options.counts:
        _write(_counts(remaining, len(texts)))
    else:
        _write(str(hit) for hit in remaining)
        _write(f"{EXCEPTIONS.name}: no sentence breaks this rule: {exception}" for exception in unused)
    return 1 if remaining or unused else 0


def _write(lines: Iterable[str]) -> None:
    sys.stdout.write("".join(f"{line}\n" for line in lines))


def _chosen(paths: list[str]) -> list[str]:
    named = [path.removeprefix(f"{ROOT}/").rstrip("/") for path in paths]
    return [
        path for path in tracked() if not named or any(path == name or path.startswith(f"{name}/") for name in named)
    ]


def _counts(remaining: list[Hit], texts: int) -> Iterator[str]:
    yield f"{texts} texts, {len(remaining)} hits"
    for rule in RULES:
        folders = Counter(hit.text.path.partition("/")[0] for hit in remaining if hit.rule == rule)
        largest = ", ".join(f"{folder} {count}" for folder, count in folders.most_common(MOST_FOLDERS))
        yield f"{folders.total():6}  {rule:32} {largest}"


if __name__ == "__main__":
    sys.exit(main())
