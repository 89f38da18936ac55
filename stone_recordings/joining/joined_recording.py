"""A joined recording as a value, and as the folder that `stone_recordings.bags.bag.open_bag` opens."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from stone_files.joined_file import JOINED, JoinedMember, joined_bytes
from stone_recordings.bags.errors import IngestError


@dataclass(frozen=True)
class JoinedRecording:
    """The recordings, the reference first, and the entry of `joined.json` for each."""

    paths: tuple[Path, ...]
    members: tuple[JoinedMember, ...]

    @property
    def name(self) -> str:
        """The run's name: that of its reference."""
        return self.paths[0].stem


def write_joined(joined: JoinedRecording, folder: Path, sha256s: Mapping[str, str] | None = None) -> None:
    """Write into an empty folder: links to the recordings, and `joined.json`, last.

    `sha256s` are known hashes of the recordings by name.
    """
    for path in joined.paths:
        os.symlink(path.resolve(), folder / path.name)
    members = [replace(member, sha256=(sha256s or {}).get(member.name, "")) for member in joined.members]
    (folder / JOINED).write_bytes(joined_bytes(members))


# Refusals to join recordings. Each sentence contains the cause, and the option that settles it.


OPTION = "--clock-offset {name}=SECONDS, what is added to its stamps"


def unmeasured_offset(names: Sequence[str], reasons: Sequence[str]) -> IngestError:
    why = "; ".join(dict.fromkeys(reasons)) or "it holds no camera, radar or IMU"
    return IngestError(
        "SYN-523",
        f"the clock of {' and '.join(names)} cannot be compared with the other recordings': {why}; "
        f"give it: {OPTION.format(name=names[0])} (0 if the clocks were synchronised)",
    )


def no_common_time(name: str, apart_s: float, reference: str) -> IngestError:
    when = "after the end" if apart_s > 0 else "before the beginning"
    return IngestError(
        "SYN-525",
        f"{name} lies {abs(apart_s):.3f} s {when} of {reference}, on its clock: is it of another run, or is its "
        f"offset wrong? {OPTION.format(name=name)}",
    )
