"""A joined recording as a value, and written as the folder that `stone_recordings.bags.bag.open_bag` opens."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from stone_files.joined_file import JOINED, JoinedMember, joined_bytes


@dataclass(frozen=True)
class JoinedRecording:
    """The recordings, the reference first, and what `joined.json` says of each."""

    paths: tuple[Path, ...]
    members: tuple[JoinedMember, ...]

    @property
    def name(self) -> str:
        """The run's, by its reference."""
        return self.paths[0].stem


def write_joined(joined: JoinedRecording, folder: Path, sha256s: Mapping[str, str] | None = None) -> None:
    """Into an empty folder: links to the recordings, and `joined.json`, last.

    `sha256s` are hashes of the recordings by name, where they are known.
    """
    for path in joined.paths:
        os.symlink(path.resolve(), folder / path.name)
    members = [replace(member, sha256=(sha256s or {}).get(member.name, "")) for member in joined.members]
    (folder / JOINED).write_bytes(joined_bytes(members))
