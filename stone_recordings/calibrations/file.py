"""A calibration from its file, folder, zip or recording: recognised, understood, checked. The page to read first.

    bytes, bounded → documents → parts, one per document → draft, all parts together → calibration → checks

**Conventions.** Fifteen formats are read. The native one is YAML that starts with `stone_calibration: 1` and contains
everything. Every other one lacks something: ROS camera_info and Kalibr place no LiDAR, Autoware has no lens, nuScenes
no image size, a URDF no lens. KITTI, RELLIS-3D, OpenCV, direct_visual_lidar_calibration, FAST-LIVO2, FAST-LIO and
LIO-SAM place nothing on the ground under the robot. Other files in the same zip or folder complete them, and a rig
document (`stone_rig: 1`, `stone_recordings.calibrations.rig`) adds values that no tool writes. If something is still
missing, the refusal names the missing part. A recording is read by its /tf_static and CameraInfo. Findings report
repairs and doubts; worse faults are raised.
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

# The formats in order of precedence: the first in a bundle names the bundle's format.
RANKS: tuple[Format, ...] = (
    "native", "kalibr", "opencalib", "nuscenes", "autoware", "kitti", "rellis", "opencv", "visual_lidar",
    "fast_livo2", "fast_lio", "lio_sam", "ros_camera_info", "urdf", "tf_static",
)  # fmt: skip

DEFAULT_FOOTPRINT = "CAL-436"


@dataclass(frozen=True, eq=False)
class CalibrationRead:
    """A calibration, its findings, and its format."""

    calibration: Calibration
    findings: Findings
    format: Format


def read_calibration(path: Path, recording: Bag | None = None) -> tuple[Calibration, Findings]:
    """Return the calibration at `path`, and its findings; raises the errors of `read_any_calibration`.

    If `path` is a `recording` that the caller has open, it is not opened again.
    """
    if recording is not None and recording.path == path:
        read = _recorded(recorded_part(recording), path.name)
    else:
        read = read_any_calibration(path)
    return read.calibration, read.findings


def read_any_calibration(path: Path) -> CalibrationRead:
    """Read a calibration as `read_calibration_files` does, or from a recording's own topics.

    Raises the errors of `read_calibration_files`, and of opening and decoding a recording (BAG-*, MSG-*).
    """
    if not is_recording(path):
        return read_calibration_files(path)
    with open_bag(path) as bag:
        return _recorded(recorded_part(bag), path.name)


def _recorded(part: CalibrationPart, name: str) -> CalibrationRead:
    return _assembled(RecognisedBundle(None, (part,), RigDocument(stone_rig=1)), Bundle(()), name)


def read_calibration_files(path: Path) -> CalibrationRead:
    """Read the calibration in a YAML or JSON file, or in a zip or folder of them.

    Raises OSError; CAL-42x for the files, CAL-40x and CAL-41x for the numbers; ShapeError for a wrong length.
    """
    return read_files(read_bundle(path), path.name)


def read_files(bundle: Bundle, name: str) -> CalibrationRead:
    """Return the calibration in files that were read already; `name` is their common name. Raises as above."""
    recognised_bundle = recognised(bundle, name)
    if recognised_bundle.native is None:
        return _assembled(recognised_bundle, bundle, name)
    calibration, findings = native(*recognised_bundle.native)
    content = recognised_bundle.native[1]
    findings += _footprint_finding(isinstance(content, dict) and content.get("footprint") is not None)
    return CalibrationRead(calibration, findings + _whole(calibration, bundle), "native")


def _assembled(recognised_bundle: RecognisedBundle, bundle: Bundle, name: str) -> CalibrationRead:
    calibration, findings = assembled(draft_of(name, recognised_bundle.parts), recognised_bundle.rig)
    noticed = tuple(finding for part in recognised_bundle.parts for finding in part.findings)
    noticed += _footprint_finding(recognised_bundle.rig.footprint is not None)
    return CalibrationRead(calibration, noticed + findings + _whole(calibration, bundle), _format(recognised_bundle))


def calibration_sha256(path: Path) -> str:
    """Return the hash of a file's bytes, or of a folder's document names and bytes. Raises the errors of
    `read_bundle`.
    """
    if path.is_file():
        return sha256(path.read_bytes()).hexdigest()
    digest = sha256()
    for name, content in read_bundle(path).documents:
        digest.update(f"{len(name.encode())} {name} {len(content)} ".encode() + content)
    return digest.hexdigest()


def _format(recognised_bundle: RecognisedBundle) -> Format:
    formats = {part.format for part in recognised_bundle.parts}
    return next((rank for rank in RANKS if rank in formats), "native")


def _whole(calibration: Calibration, bundle: Bundle) -> Findings:
    aside: Findings = ()
    if bundle.aside:
        shown = ", ".join(bundle.aside[:5])[:200]
        aside = (Finding("CAL-431", "info", "", f"{len(bundle.aside)} files were not read: {shown}"),)
    return check_calibration(calibration) + name_findings(calibration) + aside


def _footprint_finding(is_given: bool) -> Findings:
    """Return CAL-436 if no file contains the robot's footprint, from which T is computed."""
    default = Footprint()
    sentence = f"no footprint is given: {default.length_m:g} x {default.width_m:g} m, the paper's robot, is used"
    return () if is_given else (Finding(DEFAULT_FOOTPRINT, "info", "", sentence),)
