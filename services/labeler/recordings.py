"""The recordings that labels are made of: their sweeps, and the samples of all sensors for exports.

**Conventions.** Nothing is opened before the first sweep or sample is asked for.
"""

from functools import partial

from services.domain.sequences.recording_sources import kept_recording, locate
from services.runtime.orm import Recording
from services.runtime.platform import Platform
from stone.errors import StoneError
from stone.sensors.sequence import Sequence
from stone_recordings.sync.samples import BagSamples
from stone_recordings.sync.sweep_file import read_sweeps
from stone_recordings.sync.sweeps import BagSweeps


class RecordingDeletedError(StoneError):
    """The recording that labels were made of is no longer kept."""

    code = "recording_deleted"

    def __init__(self, recording_id: str) -> None:
        super().__init__(f"recording {recording_id} was deleted, so what it holds cannot be exported any more")


def described_sweeps(platform: Platform, description: bytes) -> BagSweeps:
    """The sweeps that `sweep_file.sweeps_bytes` described, wherever this worker finds the recording."""
    return read_sweeps(description, partial(locate, platform))


def samples_of(platform: Platform, recording_id: str, sequence: Sequence) -> BagSamples:
    """What the sensors gave for each frame of a sequence made of this recording. Raises `RecordingDeletedError`."""
    with platform.database.reading() as session:
        recording = session.get(Recording, recording_id)
        if recording is None:
            raise RecordingDeletedError(recording_id)
        kept = kept_recording(session, recording)
    return BagSamples(locate(platform, kept), sequence)
