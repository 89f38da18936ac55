"""The previews of a recording, by name: an engineer's first view of it."""

from collections.abc import Iterator

from stone_recordings.bags.bag import Bag
from stone_recordings.report.inspection import Inspection
from stone_recordings.report.previews.camera_strip import camera_strip
from stone_recordings.report.previews.sweep_view import sweep_view
from stone_recordings.report.previews.track_view import track_of, track_view
from stone_recordings.report.quality.sampling import SampledMessages

CAMERAS, SWEEP, TRACK = "cameras.jpg", "sweep.png", "track.png"


def previews_of(
    bag: Bag, inspection: Inspection, sampled: SampledMessages | None = None
) -> Iterator[tuple[str, str, bytes]]:
    """Yield (name, media type, bytes) of the previews that the recording allows, in the order of their names.

    A few messages are read, independent of the recording's length, and none that was `sampled` before. One picture is
    in memory at a time.
    """
    if (strip := camera_strip(bag, inspection)) is not None:
        yield CAMERAS, "image/jpeg", strip
    if (sweep := sweep_view(bag, inspection)) is not None:
        yield SWEEP, "image/png", sweep
    if (track := track_of(bag, inspection, sampled)) is not None:
        yield TRACK, "image/png", track_view(track)
