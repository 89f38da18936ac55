"""The outlook of a recording: what labelling would refuse or leave out, said by the code that will do so.

    inspection → the same synchronisation that labels are made from → its findings beside those of the inspection

**Conventions.** With a calibration everything is looked at that comes before labelling. Without one, a rig whose parts
all sit in one place stands in for it, and what is found about mounts is not said.
"""

from dataclasses import replace
from pathlib import Path

from services.ingest.pipeline import SynchroniseOptions, synchronise_in, unjoined_sequence
from stone.errors import StoneError
from stone.findings import Finding
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration, Mount
from stone_recordings.bags.bag import Bag
from stone_recordings.calibrations.file import read_calibration
from stone_recordings.report.inspection import Inspection, inspect_in, scanned
from stone_recordings.report.scan import Scan
from stone_recordings.topics.profiles import TopicProfile

NAME = "outlook"
STAND_IN = Calibration(name="none", ego_from_lidar=SE3.identity(), mounts=(Mount("INS", "ins", SE3.identity()),))
OF_MOUNTS = "CAL-"


def inspected_in(
    bag: Bag,
    profile: TopicProfile | None = None,
    calibration: Path | None = None,
    options: SynchroniseOptions | None = None,
    *,
    scan: Scan | None = None,
) -> Inspection:
    """The inspection with the outlook among its findings; the topics of `options` are those of the profile.

    `scan` spares another where the caller has one. A recording is read once for both.

    Raises as `inspect_in` and `read_calibration` do.
    """
    asked = replace(options or SynchroniseOptions(), topics=profile.topics if profile else {}, is_hashed=False)
    scan = scan or scanned(bag, asked.asked_topics)
    inspection = inspect_in(bag, profile, scan)
    if asked.poses is not None:
        told = tuple(finding for finding in inspection.findings if finding.code != "TOP-103")
        inspection = replace(inspection, findings=told)
    options = replace(asked, recorded=scan.recorded)
    if calibration is None:
        said = outlook(bag, None, options)
    else:
        rig, noticed = read_calibration(calibration, bag)
        said = (*noticed, *outlook(bag, rig, options))
    return replace(inspection, findings=with_new(inspection.findings, said))


def outlook(bag: Bag, calibration: Calibration | None, options: SynchroniseOptions) -> tuple[Finding, ...]:
    """What synchronisation finds; its refusal as an error, as a warning where a calibration may yet avert it."""
    try:
        if calibration is not None:
            return synchronise_in(bag, calibration, replace(options, is_hashed=False), NAME)[0].findings
        found = unjoined_sequence(bag, STAND_IN, options, NAME)[0].findings
    except StoneError as refusal:
        return (Finding(refusal.code, "warning" if calibration is None else "error", "", str(refusal)),)
    return tuple(finding for finding in found if not finding.code.startswith(OF_MOUNTS))


def with_new(known: tuple[Finding, ...], said: tuple[Finding, ...]) -> tuple[Finding, ...]:
    """Both, without what is said twice: the same code of the same topic, or of none in particular."""
    codes, named = {finding.code for finding in known}, {(finding.code, finding.topic) for finding in known}
    new = [one for one in said if (one.code, one.topic) not in named and (one.topic or one.code not in codes)]
    return (*known, *new)
