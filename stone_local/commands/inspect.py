"""`stone inspect`: what is in a recording, and what is wrong with it."""

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

    Where several topics fit one role, choose with --topic and save the choice for the robot's next recording.
    What labelling with the same options would refuse or leave out is shown too; with --calibration also what is wrong
    with the mounts.
    Several recordings of one run are joined first, with --calibration where their clocks must be measured; their
    offsets, what two of them hold and what lies between them is shown.
    With --html its quality is measured too: a page with plots, and under --json one more key.
    Exit code 1 if labels cannot be made of it so, or something in it cannot be used: an error line names it.
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
        with scanning(opened, asked_topics) as scan:  # which inflates while these are loaded
            from services.ingest.sandboxed_inspection import inspected_in
            from stone.kernels.loading import load_compiler

            load_compiler()
            asked = options()
        inspection = inspected_in(opened, profile, calibration, asked, scan=scan.result())
        record: dict[str, Any] = inspection.as_record()
        if opened.recordings:
            record["recordings"] = [asdict(recording) for recording in opened.recordings]
        findings = inspection.findings
        if html is not None:
            quality = write_quality_page(opened, inspection, html)
            # What labels need and lack is an error of the inspection already.
            left_out = [replace(one, severity="warning") for one in quality.left_out]
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
def scanning(bag: "Bag", asked: "AskedTopics") -> "Iterator[Future[Scan]]":
    """The scan of a recording, which a thread makes meanwhile; at the end it is there, or what it raised."""
    from stone_recordings.report.inspection import scanned

    with ThreadPoolExecutor(1) as pool:
        yield pool.submit(scanned, bag, asked)
