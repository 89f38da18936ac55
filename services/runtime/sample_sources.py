"""How a worker of one service opens the samples of a recording that another service can read.

**Conventions.** As `services/runtime/sweep_sources.py`: ingest says here, when its tasks are loaded, how a recording of
the platform is opened; the labeler's exports ask here.
"""

from collections.abc import Callable

from services.runtime.platform import Platform
from stone.errors import StoneError
from stone.samples import SampleSource
from stone.sequence import Sequence

OpenSamples = Callable[[Platform, str, Sequence], SampleSource]
_PROVIDED: list[OpenSamples] = []


class NoSamplesProvidedError(StoneError):
    """This worker cannot read recordings."""

    code = "no_samples_provided"

    def __init__(self) -> None:
        super().__init__("nothing in this worker reads recordings; was it started without the tasks of ingest?")


class RecordingDeletedError(StoneError):
    """The recording that labels were made of is no longer kept."""

    code = "recording_deleted"

    def __init__(self, recording_id: str) -> None:
        super().__init__(f"recording {recording_id} was deleted, so what it holds cannot be exported any more")


def provide_samples(opened: OpenSamples) -> None:
    """From now on the samples of a recording are opened so."""
    _PROVIDED[:] = [opened]


def open_samples(platform: Platform, recording_id: str, sequence: Sequence) -> SampleSource:
    """The samples of a sequence that was made of this recording. Raises `NoSamplesProvidedError`,
    `RecordingDeletedError`."""
    if not _PROVIDED:
        raise NoSamplesProvidedError
    return _PROVIDED[0](platform, recording_id, sequence)
