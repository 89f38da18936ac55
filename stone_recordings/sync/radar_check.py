"""The check that the scans of each radar can be read, by some of them.

**Conventions.** Heads were looked at before; what lies behind them only decoding tells. A radar whose scans cannot be
read costs its own samples alone, so each is a warning.
"""

import numpy as np

from stone.findings import Finding
from stone_recordings.bags.bag import Bag
from stone_recordings.bags.errors import IngestError
from stone_recordings.messages.radars.radar import decode_radar
from stone_recordings.sync.recorded_messages import RecordedTopics

MOST_TRIED = 32


def radar_findings(bag: Bag, recorded: RecordedTopics, topics: tuple[str, ...]) -> tuple[Finding, ...]:
    """Return a finding for each radar with scans, among those tried, that cannot be decoded.

    Raises what reading the bag raises (BAG-*).
    """
    return tuple(finding for name in topics for finding in _of_topic(bag, recorded, name))


def _of_topic(bag: Bag, recorded: RecordedTopics, name: str) -> tuple[Finding, ...]:
    topic, usable = recorded.topics[name], recorded.usable(name)
    tried = usable[np.unique(np.linspace(0, len(usable) - 1, min(len(usable), MOST_TRIED)).astype(np.int64))]
    refused = list[IngestError]()
    for index in tried.tolist():
        message = bag.message(name, index)
        try:
            decode_radar(topic.type, [message], topic.schema)
        except IngestError as error:
            refused.append(error)
    if not refused:
        return ()
    sentence = (
        f"{len(refused)} of the {len(tried)} scans that were tried cannot be read (the first: {refused[0]}); frames "
        "have none of them"
    )
    return (Finding(refused[0].code, "warning", name, sentence),)
