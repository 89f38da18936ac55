"""Several recordings of one run on the command line: the arguments, `--clock-offset`, and the joined recording.

**Conventions.** One recording stays as it is. Several are joined into a temporary folder of links.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from stone_client.clock_offsets import chosen_clock_offsets
from stone_files.recording_name import sequence_name

if TYPE_CHECKING:
    from services.ingest.pipeline import SynchroniseOptions
    from stone_recordings.joining.joined_recording import JoinedRecording


@dataclass(frozen=True)
class RunRecordings:
    """The command's arguments; `options` are for the comparison of clocks, topics and poses."""

    paths: Sequence[Path]
    clock_offsets: Sequence[str]
    calibration: Path | None
    options: "Callable[[], SynchroniseOptions]"


@dataclass(frozen=True)
class OpenRun:
    """The recording of a run; `joined` is None for a single recording."""

    bag: Path
    name: str
    joined: "JoinedRecording | None" = None


@contextmanager
def run_of(recordings: RunRecordings) -> Iterator[OpenRun]:
    """Yield the open recording of a run. Raises `typer.BadParameter`, and what `join_recordings` raises."""
    given_ns = chosen_clock_offsets(recordings.clock_offsets)
    if len(recordings.paths) == 1 and not given_ns:
        yield OpenRun(recordings.paths[0], sequence_name(recordings.paths[0]))
        return
    from services.ingest.joining.clocks import JoinRequest, join_recordings
    from stone_recordings.bags.private_folder import PrivateFolder
    from stone_recordings.joining.joined_recording import write_joined

    request = JoinRequest(tuple(recordings.paths), recordings.calibration, given_ns, recordings.options())
    joined = join_recordings(request)
    private = PrivateFolder()
    try:
        folder = private.path / joined.name
        folder.mkdir()
        write_joined(joined, folder)
        yield OpenRun(folder, joined.name, joined)
    finally:
        private.close()
