"""Checks that several uploaded files are one bag, and hashes them as a whole.

**Conventions.** The files of a rosbag2 folder: one or more of `.mcap` or of `.db3`, or the parts of a split ROS 1
`.bag` (`.bag.active` where its recorder died), each perhaps compressed as a file by zstd, a database perhaps beside
the journal of what was not finished; perhaps `metadata.yaml`; and definitions of messages where the recorder embedded
none (`my_msgs.Reading.msg`). Names are compared as on a disk that does not tell cases apart, so that a folder can be
written anywhere.
"""

import re
from collections.abc import Iterable, Sequence
from hashlib import sha256

from stone_base.errors import StoneError

METADATA = "metadata.yaml"
MOST_FILES = 512
BAG_FILE = re.compile(r".+\.(mcap|db3|bag)(\.active|\.zstd)?", re.IGNORECASE)
LEFT_BESIDE = ("-wal", "-journal")
JOURNAL = re.compile(r"(.+\.db3)-(wal|journal)", re.IGNORECASE)
DEFINITION = re.compile(r"[a-z][a-z0-9_]{0,99}\.[A-Z][A-Za-z0-9]{0,99}\.msg")


class BadBagFilesError(StoneError):
    """The files cannot be one bag."""

    code = "bad_recording_files"

    def __init__(self, why: str) -> None:
        files = "its .mcap, .db3 or .bag files, and the metadata.yaml of a rosbag2 folder"
        super().__init__(f"{why}; send the files of one recording: {files}")


def is_bag_part(name: str) -> bool:
    """Whether a file so called belongs to a bag."""
    return name == METADATA or any(form.fullmatch(name) for form in (BAG_FILE, JOURNAL, DEFINITION))


def check_bag_files(names: Sequence[str]) -> None:
    """Raises `BadBagFilesError` where files so called are not one bag of several files."""
    if not 2 <= len(names) <= MOST_FILES:
        raise BadBagFilesError(f"these are {len(names)} files, a bag of several has 2 to {MOST_FILES}")
    for name in names:
        if not is_bag_part(name):
            raise BadBagFilesError(f"{name[:100]!r} is not part of a bag")
    folded = {name.casefold() for name in names}
    if len(folded) < len(names):
        raise BadBagFilesError(f"{len(names)} files have only {len(folded)} names")
    storages = {form[1].casefold() for name in names if (form := BAG_FILE.fullmatch(name))}
    if not storages:
        raise BadBagFilesError("there is no .mcap, no .db3 and no .bag file")
    if len(storages) > 1:
        raise BadBagFilesError(
            f"files of several kinds are there: {', '.join(f'.{kind}' for kind in sorted(storages))}"
        )
    for name in names:
        journal = JOURNAL.fullmatch(name)
        if journal and journal[1].casefold() not in folded:
            raise BadBagFilesError(f"{name[:100]!r} has no {journal[1][:100]!r} beside it")


def whole_sha256(files: Iterable[tuple[str, str]]) -> str:
    """The hash of (name, sha256) of several files: that of the lines `sha256sum` prints for them in order of name."""
    return sha256("".join(f"{digest}  {name}\n" for name, digest in sorted(files)).encode()).hexdigest()
