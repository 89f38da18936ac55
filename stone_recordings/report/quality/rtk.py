"""RTK quality: how often the receiver had a fix, and the accuracy it estimates itself.

**Conventions.** Words by NovAtel's position types (OEM7 "Position or Velocity Type"): integer ambiguities resolved are
"fixed", float ones "float", everything else (single, PPP, none) "other". NavSatFix cannot tell RTK from DGPS, so it is
not asked.
"""

import numpy as np
from numpy.typing import NDArray

from stone_recordings.bags.bag import RawMessage, Topic
from stone_recordings.messages.novatel import FixSamples, InsSamples, decode_bestpos, decode_inspva
from stone_recordings.report.quality.facts import RtkFacts, RtkWord
from stone_recordings.report.quality.sampling import TINY, TopicSampling

BESTPOS, INSPVAX = "novatel_oem7_msgs/msg/BESTPOS", "novatel_oem7_msgs/msg/INSPVAX"
RTK_TYPES = (BESTPOS, INSPVAX)
WORD_OF_TYPE: dict[int, RtkWord] = {
    **dict.fromkeys((48, 49, 50, 56), "fixed"),  # L1_INT, WIDE_INT, NARROW_INT, INS_RTKFIXED
    **dict.fromkeys((32, 33, 34, 55), "float"),  # L1_FLOAT, IONOFREE_FLOAT, NARROW_FLOAT, INS_RTKFLOAT
}
MOST_STDEV_M = 1e4


class RtkLook:
    """Collects the solution types of one topic."""

    def __init__(self, topic: Topic) -> None:
        self.topic = topic
        self._seen: list[tuple[int, RtkWord, float]] = []

    @property
    def look(self) -> TopicSampling:
        return TopicSampling(self.topic, self._see, TINY)

    def _see(self, at_ns: int, payload: memoryview) -> None:
        samples = decode_solution(self.topic, RawMessage(at_ns, 0, payload))
        if samples.pos_type is not None and samples.position_stdev_m is not None:
            word = WORD_OF_TYPE.get(int(samples.pos_type[0]), "other")
            self._seen.append((at_ns, word, _horizontal_m(samples.position_stdev_m[0])))

    def facts(self) -> RtkFacts | None:
        """None where the receiver never spoke."""
        if not self._seen:
            return None
        at_ns, words, stdev_m = zip(*self._seen, strict=True)
        return RtkFacts(self.topic.name, at_ns, words, stdev_m)


def decode_solution(topic: Topic, message: RawMessage) -> FixSamples | InsSamples:
    """One sample, by the definition that the recording embeds. Raises what `decode_bestpos` raises."""
    if topic.type == BESTPOS:
        return decode_bestpos([message], topic.schema)
    return decode_inspva([message], topic.schema)


def _horizontal_m(stdev_m: NDArray[np.float64]) -> float:
    """The larger of the two axes; what no receiver means (NaN, kilometres) is the largest that is kept."""
    larger_m = float(np.max(np.abs(stdev_m[:2])))
    return larger_m if larger_m <= MOST_STDEV_M else MOST_STDEV_M
