"""The sound drives that faults are made of, and the altered drive that a fault makes of one.

**Conventions.** A drive is one MCAP file with its calibration. `topics` are its topics by role; the role "pose" is that
of the pose source. If there are several cameras or radars, the first counts.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from mcap.writer import CompressionType

from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate
from stone.sensors.calibration import Calibration
from stone_recordings.bags.bag import open_bag
from stone_recordings.calibrations.file import read_calibration
from stone_recordings.report.inspection import inspect
from testing.worlds.altered import altered
from testing.worlds.faults.edits import STORE, serialised
from testing.worlds.faults.fault import RecordingFault, listed

KITTI = Path("kitti0005_ros2_mcap") / "kitti0005_lidar_odom.mcap"
EXAMPLE = Path(__file__).resolve().parents[3] / "examples" / "kitti0005.calibration.yaml"
SECONDS = 5.0
# Its stamps are the receiver's: a host that stamps late would be another finding.
SIMULATED = SimulateOptions(
    seconds=SECONDS,
    seed=5,
    channels=32,
    columns=360,
    camera_width_px=64,
    compression="none",
    world_width_m=30.0,
    host_delay_max_ns=0,
    transport_jitter_ns=300_000,
)


@dataclass(frozen=True)
class SoundDrive:
    """A recording, its calibration, and its topics: type by name, name by role."""

    name: str
    bag: Path
    calibration: Path
    types: Mapping[str, str]
    topics: Mapping[str, str]

    def has(self, fault: RecordingFault) -> bool:
        """Return whether the drive can have the fault."""
        topic = self.topics.get(fault.role)
        if fault.role and topic is None:
            return False
        return not fault.needs_type or (topic is not None and self.types[topic] == fault.needs_type)

    def rig(self, fault: RecordingFault | None = None) -> Calibration:
        """Return its calibration, altered by the fault."""
        rig = read_calibration(self.calibration)[0]
        return rig if fault is None or fault.misreading is None else fault.misreading(rig)


def simulated_drive(folder: Path) -> SoundDrive:
    """Return a few seconds of the paper's rig, reusing an earlier call's files."""
    bag = folder / "simulated.mcap"
    if not bag.exists():
        simulate(bag, SIMULATED)
    return _drive("simulated", bag, calibration_path(bag))


def kitti_drive(field_data: Path, folder: Path) -> SoundDrive:
    """Return the first seconds of a car's drive with its odometry."""
    bag = folder / "kitti.mcap"
    if not bag.exists():
        with open_bag(field_data / KITTI) as whole:
            end_ns = whole.start_ns + round(SECONDS * 1e9)
        altered(field_data / KITTI, bag, lambda _topic, log_ns, data: bytes(data) if log_ns < end_ns else None)
    return _drive("kitti", bag, EXAMPLE)


def _drive(name: str, bag: Path, calibration: Path) -> SoundDrive:
    topics = inspect(bag).topics
    roles: dict[str, str] = {topic.role: topic.topic.name for topic in reversed(topics)}
    pose = roles.get("ins") or roles["odometry"]
    return SoundDrive(
        name, bag, calibration, {topic.topic.name: topic.topic.type for topic in topics}, {**roles, "pose": pose}
    )


def faulty(drive: SoundDrive, fault: RecordingFault, target: Path) -> Path:
    """Write the drive's recording with the fault; return the drive's own if the calibration has the fault."""
    if fault.edit is None and fault.damage is None:
        return drive.bag
    made = _Alteration(drive, fault)
    compression = CompressionType.ZSTD if fault.is_compressed else CompressionType.NONE
    altered(drive.bag, target, made.of, compression)
    if fault.damage is not None:
        fault.damage(target)
    return target


class _Alteration:
    """Count the messages of the fault's topic and edit the selected messages."""

    def __init__(self, drive: SoundDrive, fault: RecordingFault) -> None:
        self._fault, self._topic, self._seen = fault, drive.topics.get(fault.role), Counter[str]()
        self._type = drive.types.get(self._topic or "", "")
        with open_bag(drive.bag) as bag:
            self._count = next((topic.count for topic in bag.topics if topic.name == self._topic), 0)

    def of(self, topic: str, _log_ns: int, data: bytearray) -> list[bytes]:
        index = self._seen[topic]
        self._seen[topic] += 1
        if self._fault.edit is None or topic != self._topic or not self._fault.pick(index, self._count):
            return [bytes(data)]
        message = STORE.deserialize_cdr(bytes(data), self._type)
        return [serialised(edited) for edited in listed(self._fault.edit(message))]
