"""The check that the scans of each radar can be decoded, on a sample.

**Conventions.** An earlier check covers message headers; only decoding checks the rest. An unreadable radar loses its
own samples alone, so each finding is a warning. Scans of all radars are read in the order of time, so that a chunk of a
compressed recording is inflated once for all of them.
"""

import numpy as np

from stone.findings import Finding
from stone_recordings.bags.bag import Bag
from stone_recordings.bags.errors import IngestError
from stone_recordings.messages.radars.radar import decode_radar
from stone_recordings.sync.recorded_messages import RecordedTopics

MOST_TRIED = 16


def radar_findings(bag: Bag, recorded: RecordedTopics, topics: tuple[str, ...]) -> tuple[Finding, ...]:
    """Return a finding for each radar with scans, among those tried, that cannot be decoded.

    Raises what reading the bag raises (BAG-*).
    """
    tried = {name: _spread(recorded, name) for name in topics}
    refused: dict[str, list[IngestError]] = {name: [] for name in topics}
    scans = [(int(recorded.log_times_ns[name][index]), name, index) for name in topics for index in tried[name]]
    for _time_ns, name, index in sorted(scans):
        topic, message = recorded.topics[name], bag.message(name, index)
        try:
            decode_radar(topic.type, [message], topic.schema)
        except IngestError as error:
            refused[name].append(error)
    return tuple(_finding(name, len(tried[name]), errors) for name, errors in refused.items() if errors)


def _spread(recorded: RecordedTopics, name: str) -> list[int]:
    usable = recorded.usable(name)
    rows = np.unique(np.linspace(0, len(usable) - 1, min(len(usable), MOST_TRIED)).astype(np.int64))
    return [int(index) for index in usable[rows]]


def _finding(name: str, tried: int, errors: list[IngestError]) -> Finding:
    sentence = (
        f"{len(errors)} of the {tried} scans that were tried cannot be read (the first: {errors[0]}); frames have none "
        "of them"
    )
    return Finding(errors[0].code, "warning", name, sentence)
