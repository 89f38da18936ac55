"""A calibration from its file, folder, zip or recording: recognised, understood, checked. The page to read first.

    bytes, bounded → documents → parts, one per document → draft, all parts together → calibration → checks

**Conventions.** Fifteen formats are read. The native one is YAML that begins with `stone_calibration: 1` and says all.
Every other one was made to say less: ROS camera_info and Kalibr place no LiDAR, Autoware no lens, nuScenes no image
size, a URDF no lens; KITTI, RELLIS-3D, OpenCV, direct_visual_lidar_calibration, FAST-LIVO2, FAST-LIO and LIO-SAM place
nothing on the ground under the robot. They are completed by each other's files in one zip or
folder, and by a rig document (`stone_rig: 1`, `stone_recordings.calibrations.rig`) for what no tool writes. What is
still missing is refused as half a rig, with what to add. A recording is read by its /tf_static and CameraInfo. Findings
are what was repaired or is doubtful; everything worse is raised.
"""

from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from stone.findings import Finding
from stone.sensors.calibration import Calibration, Footprint
from stone.sensors.calibration_checks import Findings, check_calibration
from stone.sensors.camera_views import name_findings
from stone_files.calibration_bundle import Bundle, read_bundle
from stone_recordings.bags.bag import Bag, open_bag
from stone_recordings.calibrations.assembly import assembled
from stone_recordings.calibrations.draft import draft_of
from stone_recordings.calibrations.native import RigDocument, native
from stone_recordings.calibrations.part import CalibrationPart, Format
from stone_recordings.calibrations.recognition import RecognisedBundle, recognised
from stone_recordings.calibrations.recording_rig import is_recording, recorded_part

# Of the formats in a bundle, the first of these is what it is called.
RANKS: tuple[Format, ...] = (
    "native", "kalibr", "opencalib", "nuscenes", "autoware", "kitti", "rellis", "opencv", "visual_lidar",
    "fast_livo2", "fast_lio", "lio_sam", "ros_camera_info", "urdf", "tf_static",
)  # fmt: skip

DEFAULT_FOOTPRINT = "CAL-436"


@dataclass(frozen=True, eq=False)
class CalibrationRead:
    """A calibration, what was noticed about it, and the format it came in."""

    calibration: Calibration
    findings: Findings
    format: Format


def read_calibration(path: Path, recording: Bag | None = None) -> tuple[Calibration, Findings]:
    """The calibration at `path`, and what was repaired or is doubtful about it; raises as `read_any_calibration`.

    A `recording` that the caller has open is not opened again where `path` is that recording.
    """
    if recording is not None and recording.path == path:
        read = _recorded(recorded_part(recording), path.name)
    else:
        read = read_any_calibration(path)
    return read.calibration, read.findings


def read_any_calibration(path: Path) -> CalibrationRead:
    """As `read_calibration_files`, or from a recording's own topics.

    Raises as `read_calibration_files`, and what opening and decoding a recording raise (BAG-*, MSG-*).
    """
    if not is_recording(path):
        return read_calibration_files(path)
    with open_bag(path) as bag:
        return _recorded(recorded_part(bag), path.name)


def _recorded(part: CalibrationPart, name: str) -> CalibrationRead:
    return _assembled(RecognisedBundle(None, (part,), RigDocument(stone_rig=1)), Bundle(()), name)


def read_calibration_files(path: Path) -> CalibrationRead:
    """The calibration in a YAML or JSON file, or in a zip or folder of them.

    Raises OSError; CAL-42x for the files, CAL-40x and CAL-41x for the numbers; ShapeError for another length.
    """
    return read_files(read_bundle(path), path.name)


def read_files(bundle: Bundle, name: str) -> CalibrationRead:
    """The calibration in files that were read already; `name` is what they are called together. Raises as above."""
    found = recognised(bundle, name)
    if found.native is None:
        return _assembled(found, bundle, name)
    calibration, findings = native(*found.native)
    content = found.native[1]
    findings += _footprint_finding(isinstance(content, dict) and content.get("footprint") is not None)
    return CalibrationRead(calibration, findings + _whole(calibration, bundle), "native")


def _assembled(found: RecognisedBundle, bundle: Bundle, name: str) -> CalibrationRead:
    calibration, findings = assembled(draft_of(name, found.parts), found.rig)
    noticed = tuple(finding for part in found.parts for finding in part.findings)
    noticed += _footprint_finding(found.rig.footprint is not None)
    return CalibrationRead(calibration, noticed + findings + _whole(calibration, bundle), _format(found))


def calibration_sha256(path: Path) -> str:
    """Of a file its bytes; of a folder the names and bytes of its documents. Raises as `read_bundle`."""
    if path.is_file():
        return sha256(path.read_bytes()).hexdigest()
    digest = sha256()
    for name, content in read_bundle(path).documents:
        digest.update(f"{len(name.encode())} {name} {len(content)} ".encode() + content)
    return digest.hexdigest()


def _format(found: RecognisedBundle) -> Format:
    formats = {part.format for part in found.parts}
    return next((rank for rank in RANKS if rank in formats), "native")


def _whole(calibration: Calibration, bundle: Bundle) -> Findings:
    aside: Findings = ()
    if bundle.aside:
        shown = ", ".join(bundle.aside[:5])[:200]
        aside = (Finding("CAL-431", "info", "", f"{len(bundle.aside)} files were not read: {shown}"),)
    return check_calibration(calibration) + name_findings(calibration) + aside


def _footprint_finding(is_given: bool) -> Findings:
    """CAL-436 where no file says how much ground the robot covers, from which T is made."""
    default = Footprint()
    sentence = f"no footprint is given: {default.length_m:g} x {default.width_m:g} m, the paper's robot, is taken"
    return () if is_given else (Finding(DEFAULT_FOOTPRINT, "info", "", sentence),)
