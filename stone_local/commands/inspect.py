"""`stone inspect`: show the contents and faults of a recording."""

from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from stone_client.clock_offsets import ClockOffsetOption
from stone_client.options import Ground, GroundOption, LidarOption, OdometryOption, RunArgument
from stone_client.refusals import REFUSED
from stone_client.streams import JsonOption, echo_explainer, echo_findings, echo_json
from stone_client.tables import clock_table, inspection_table, recording_table, show
from stone_local.joined_run import RunRecordings, run_of
from stone_local.quality_file import HtmlOption, deduction_table, write_quality_page
from stone_local.topic_choices import (
    PosesFrameOption,
    PosesOption,
    SaveTopicsOption,
    TimeOffsetOption,
    TopicOption,
    TopicsOption,
    chosen_offsets,
    chosen_poses,
    chosen_topics,
)

if TYPE_CHECKING:
    from services.ingest.pipeline import SynchroniseOptions
    from stone_recordings.bags.bag import Bag
    from stone_recordings.report.scan import Scan
    from stone_recordings.topics.sources import AskedTopics

RigOption = Annotated[
    Path | None,
    typer.Option("--calibration", metavar="FILE", exists=True, help="Also run the checks that need this calibration."),
]


def inspect(
    bags: RunArgument,
    topics: TopicsOption = None,
    topic: TopicOption = [],  # noqa: B006
    save_topics: SaveTopicsOption = None,
    html: HtmlOption = None,
    calibration: RigOption = None,
    odometry: OdometryOption = None,
    lidar: LidarOption = None,
    ground: GroundOption = Ground.GIVEN,
    time_offset: TimeOffsetOption = [],  # noqa: B006
    poses: PosesOption = None,
    poses_frame: PosesFrameOption = "",
    clock_offset: ClockOffsetOption = [],  # noqa: B006
    as_json: JsonOption = False,
) -> None:
    """Show a recording's topics with their roles, rates, gaps and findings.

    If several topics fit one role, choose with --topic and save the choice for the robot's next recording. The findings
    include everything that labelling with the same options would refuse or skip.

    With --calibration the findings include faults of the mounts. Several recordings of one run are joined first; if
    their clocks must be measured, give --calibration. The output shows clock offsets, overlaps and gaps.

    --html also measures the quality and writes a page with plots; with --json the output includes the quality. Exit
    code 1 if the recording cannot be labelled with these options or contains unusable data.
    """
    from stone_recordings.bags.bag import open_bag
    from stone_recordings.topics.profiles import write_profile
    from stone_recordings.topics.sources import AskedTopics

    profile, offsets_ns = chosen_topics(topics, topic), chosen_offsets(time_offset)
    pose_file = chosen_poses(poses, poses_frame, odometry)

    def options() -> "SynchroniseOptions":
        from services.ingest.pipeline import SynchroniseOptions

        return SynchroniseOptions(
            odometry,
            lidar,
            poses=pose_file,
            poses_frame=poses_frame,
            topics=profile.topics,
            ground=ground.value,
            time_offsets_ns=offsets_ns,
        )

    with run_of(RunRecordings(bags, clock_offset, calibration, options)) as run, open_bag(run.bag) as opened:
        given = {role: topic for role, topic in {"lidar": lidar, "pose": odometry}.items() if topic}
        asked_topics = AskedTopics.of_roles({**profile.topics, **given}, has_pose_file=poses is not None)
        with scanning(opened, asked_topics) as scan:  # it inflates chunks while these modules load
            from services.ingest.sandboxed_inspection import inspected_in
            from stone.kernels.loading import load_compiler

            load_compiler()
            chosen_options = options()
        inspection = inspected_in(opened, profile, calibration, chosen_options, scan=scan.result())
        record: dict[str, Any] = inspection.as_record()
        if opened.recordings:
            record["recordings"] = [asdict(recording) for recording in opened.recordings]
        findings = inspection.findings
        if html is not None:
            quality = write_quality_page(opened, inspection, html)
            # the inspection already reports missing parts as errors
            left_out = [replace(item, severity="warning") for item in quality.left_out]
            record["quality"], findings = quality.as_record(), (*findings, *left_out)
    if as_json:
        echo_json(record)
    else:
        _show(record)
    if save_topics is not None:
        write_profile(save_topics, inspection.assignment.as_profile(profile.platform))
    echo_findings(findings)
    if not as_json:
        echo_explainer(findings)
    if any(finding.severity == "error" for finding in findings):
        raise typer.Exit(REFUSED)


def _show(record: dict[str, Any]) -> None:
    show(inspection_table(record))
    show(clock_table(record["clocks"]))
    if "recordings" in record:
        show(recording_table(record["recordings"]))
    if "quality" in record:
        show(deduction_table(record["quality"]))


@contextmanager
def scanning(bag: "Bag", topics: "AskedTopics") -> "Iterator[Future[Scan]]":
    """Yield a scan of a recording that runs in a thread; at the end the thread has finished or raised."""
    from stone_recordings.report.inspection import scanned

    with ThreadPoolExecutor(1) as pool:
        yield pool.submit(scanned, bag, topics)
