"""One tiny recording, made once: small enough that every message of it can be checked."""

from dataclasses import dataclass
from pathlib import Path

import pytest
from rosbags.highlevel import AnyReader

from simulator.options import SimulateOptions
from simulator.pipeline import simulate
from simulator.truth import SimulationTruth, read_truth

TINY = SimulateOptions(seconds=0.5, seed=3, channels=16, columns=120, camera_width_px=64, world_width_m=60.0)


@dataclass(frozen=True)
class Message:
    """One message as rosbags reads it."""

    topic: str
    kind: str
    log_time_ns: int
    raw: bytes
    value: object


@dataclass(frozen=True)
class Recording:
    path: Path
    truth: SimulationTruth
    messages: tuple[Message, ...]

    def of(self, topic: str) -> list[object]:
        return [message.value for message in self.messages if message.topic == topic]


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    folder = tmp_path_factory.mktemp("recording")
    path = folder / "tiny.mcap"
    simulate(path, TINY, folder / "truth")
    with AnyReader([path]) as reader:
        messages = tuple(
            Message(link.topic, link.msgtype, log_time_ns, bytes(raw), reader.deserialize(raw, link.msgtype))
            for link, log_time_ns, raw in reader.messages()
        )
    return Recording(path, read_truth(folder / "truth"), messages)
