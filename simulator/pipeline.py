"""`simulate`: a drive through a synthetic world, recorded by the whole rig of the paper, with its exact ground truth.

**Conventions.** Sweeps are processed one at a time: cast, pack, write, discard. Memory does not grow with the
recording's bytes.
"""

from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from ruamel.yaml import YAML

from simulator.appearance.renderer import Renderer
from simulator.bag_writer import open_bag_writer
from simulator.faults import all_of
from simulator.options import SimulateOptions
from simulator.recorder import Recorder
from simulator.scenery.scene import RayScene
from simulator.scenery.world import START_NS, SimulatedWorld, build_world, generator
from simulator.sensors import rig
from simulator.sensors.cameras import build_ring, take_pictures
from simulator.sensors.lidar import build_lidar, sweep_points
from simulator.sensors.navigation import Fixes, Inertia, take_fixes, take_inertia
from simulator.sensors.radar import Radars, scan, scan_stamps_ns, stale_detections
from simulator.truth import TRUTH_MARK, truth_of, write_truth
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration, Mount
from stone_files.atomic import atomic_directory, atomic_file

Progress = Callable[[str, int, int], None]
LEAD_NS = 215_000_000  # navigation runs before the first sweep; no sweep coincides with a fix
TAIL_NS = 85_000_000


def _silent(stage: str, done: int, total: int) -> None:
    """Default progress function; does nothing."""


def calibration_path(bag: Path) -> Path:
    """Return OUT.calibration.yaml beside OUT.mcap."""
    return bag.with_name(f"{bag.stem}.calibration.yaml")


def sweep_stamps_ns(options: SimulateOptions) -> list[int]:
    """Return the stamps of the recording's sweeps."""
    count = int(options.seconds * options.lidar_hz + 1e-6)
    return [START_NS + LEAD_NS + index * options.sweep_period_ns for index in range(count)]


def tick_stamps_ns(options: SimulateOptions) -> list[int]:
    """Return the start times of the rounds of cameras and radars: 10 Hz, whatever the LiDAR's rate."""
    return [START_NS + LEAD_NS + index * rig.SWEEP_NS for index in range(int(options.seconds * 10 + 1e-6))]


def simulate(out: Path, options: SimulateOptions, truth_dir: Path | None = None, progress: Progress = _silent) -> None:
    """Write the bag at `out`, `calibration_path(out)` beside it, and the truth folder if requested.

    `stone label OUT.mcap --calibration OUT.calibration.yaml` then works. Each of the three is whole or absent. Raises
    `output_exists` if a foreign file is in the way.
    """
    progress("build world", 0, 1)
    world = build_world(options)
    progress("build world", 1, 1)
    if truth_dir is not None:
        with atomic_directory(truth_dir, replaces=TRUTH_MARK) as staging:
            write_truth(truth_of(world, sweep_stamps_ns(options)), options, staging)
    with atomic_file(calibration_path(out)) as staging:
        write_calibration(all_of(options.faults).calibration(rig.calibration(options.camera_width_px)), staging)
    with atomic_file(out) as staging:
        _record(staging, options, world, progress)


def _record(path: Path, options: SimulateOptions, world: SimulatedWorld, progress: Progress) -> None:
    scene, lidar, ring, fault = RayScene(world), build_lidar(options), build_ring(options), all_of(options.faults)
    renderer = Renderer(scene, options) if options.cameras else None
    ring = replace(ring, cameras=tuple(map(fault.triggers, ring.cameras)))
    draws = {part: generator(options.seed, part) for part in ("lidar", "camera", "radar", "fixes", "imu", "stale")}
    ticks, sweeps = tick_stamps_ns(options), np.array(sweep_stamps_ns(options), np.int64)
    duration_ns = LEAD_NS + len(ticks) * rig.SWEEP_NS + TAIL_NS
    fixes = fault.fixes(take_fixes(world.trajectory, duration_ns, options, draws["fixes"]))
    inertia = fault.inertia(take_inertia(world.trajectory, duration_ns, draws["imu"], options.noise_ratio))
    radars = Radars(stale_detections(draws["stale"]), options.noise_ratio)
    with open_bag_writer(path, options.compression) as bag:
        recorder = Recorder(bag, options, fault)
        recorder.static_transforms(START_NS)
        written_until = START_NS
        for index, stamp_ns in enumerate(ticks):
            _navigate(recorder, fixes, inertia, (written_until, stamp_ns))
            bag.flush_before(stamp_ns)
            for sweep_ns in sweeps[slice(*np.searchsorted(sweeps, (stamp_ns, stamp_ns + rig.SWEEP_NS)))].tolist():
                recorder.sweep(sweep_ns, sweep_points(scene, lidar, sweep_ns, draws["lidar"]))
            for lists in scan(scene, scan_stamps_ns(stamp_ns), radars, draws["radar"]):
                recorder.radar_lists(lists)
            pictures = take_pictures(renderer, ring, stamp_ns, draws["camera"]) if renderer else []
            for picture in fault.pictures(pictures, index):
                recorder.picture(picture)
            written_until = stamp_ns
            progress("record sweeps", index + 1, len(ticks))
        _navigate(recorder, fixes, inertia, (written_until, START_NS + duration_ns + 1))


def _navigate(recorder: Recorder, fixes: Fixes, inertia: Inertia, window_ns: tuple[int, int]) -> None:
    """Record the receiver's and the IMU's samples of a half-open window of true time."""
    recorder.fixes(fixes, slice(*np.searchsorted(fixes.stamps_ns, window_ns)))
    recorder.inertia(inertia, slice(*np.searchsorted(inertia.stamps_ns, window_ns)))


# The rig's calibration in the platform's native YAML: version 1 of `stone_calibration`, metres, quaternions wxyz,
# `lidar_from_sensor` for every mount.


def write_calibration(calibration: Calibration, path: Path) -> None:
    """Write `calibration` at `path`."""
    yaml = YAML()
    yaml.default_flow_style = None
    yaml.width = 4096
    with path.open("w", encoding="utf-8") as stream:
        yaml.dump(calibration_record(calibration), stream)


def calibration_record(calibration: Calibration) -> dict[str, object]:
    """Return the nested values of the file."""
    return {
        "stone_calibration": 1,
        "name": calibration.name,
        "footprint": asdict(calibration.footprint),
        "self_boxes_ego": [{"min_m": list(box.min_m), "max_m": list(box.max_m)} for box in calibration.self_boxes_ego],
        "ego_from_lidar": _transform(calibration.ego_from_lidar),
        "sensors": {mount.name: _mount(mount) for mount in calibration.mounts},
    }


def _transform(transform: SE3) -> dict[str, list[float]]:
    return {"translation_m": transform.translation_m.tolist(), "rotation_wxyz": transform.wxyz.tolist()}


def _mount(mount: Mount) -> dict[str, object]:
    record: dict[str, object] = {
        "kind": mount.kind,
        "frame_id": mount.frame_id,
        "lidar_from_sensor": _transform(mount.lidar_from_sensor),
        "time_offset_ns": mount.time_offset_ns,
    }
    if mount.intrinsics is not None:
        lens = asdict(mount.intrinsics)
        record["intrinsics"] = lens | {"distortion": list(mount.intrinsics.distortion)}
    return record
