"""Whether the store holds what the database names, `python -m services.maintenance.store_check`: see
docs/operations/lost-objects.md.

**Conventions.** A line of JSON on stdout for each object that is not as it should be, sentences on stderr. Ends with 0
when nothing is lost (any more), 1 when something is, or when the store does not answer.
"""

import services.runtime.processes.startup  # noqa: F401

# isort: split

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path

from services.maintenance.store_repair import DamagedBlob, damaged_blobs, forget_derived, restore_objects
from services.runtime.platform import Platform, open_platform
from services.runtime.settings import Settings
from stone.errors import StoneError


def main(arguments: list[str] | None = None) -> int:
    options = _options(arguments)
    platform = open_platform(Settings())
    try:
        return len(_checked(platform, options)) and 1
    except StoneError as error:
        _say(f"{error.code}: {error}")
        return 1
    finally:
        platform.database.close()


def _checked(platform: Platform, options: argparse.Namespace) -> list[DamagedBlob]:
    """What is lost after everything that was asked for."""
    lost = []
    for one in damaged_blobs(platform, is_read=options.bytes):
        sys.stdout.write(json.dumps(asdict(one)) + "\n")
        lost.append(one)
    _say(f"{len(lost)} objects are lost")
    for folder in options.sources:
        back = restore_objects(platform, lost, folder)
        lost = [one for one in lost if one not in back]
        _say(f"{len(back)} were put back from {folder}; {len(lost)} are lost")
    if options.forget and lost:
        _say(f"{forget_derived(platform, lost)} label sets and exports are forgotten; ask for them again")
    return lost


def _say(sentence: str) -> None:
    sys.stderr.write(sentence + "\n")


def _options(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m services.maintenance.store_check", description=__doc__)
    parser.add_argument("--bytes", action="store_true", help="read every object and compare its sha256")
    parser.add_argument(
        "--from", action="append", default=[], type=Path, dest="sources", metavar="FOLDER", help="put back from here"
    )
    parser.add_argument("--forget", action="store_true", help="let lost labels and exports be made again")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    sys.exit(main())
