"""`stone label`: 3D traversability labels from a recording and a calibration."""

from collections.abc import Mapping
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from stone.findings import Finding
from stone_base.counts import counted
from stone_client.clock_offsets import ClockOffsetOption
from stone_client.options import (
    DEFAULT_PROFILE,
    CalibrationOption,
    GridsOption,
    Ground,
    GroundOption,
    LidarOption,
    OdometryOption,
    ParameterOption,
    ProfileOption,
    RunArgument,
    WorkersOption,
    chosen_parameters,
    cores,
)
from stone_client.progress import reported
from stone_client.streams import JsonOption, echo_explainer, echo_findings, echo_json
from stone_client.tables import class_table, show
from stone_local.joined_run import RunRecordings, run_of
from stone_local.topic_choices import (
    PosesFrameOption,
    PosesOption,
    TimeOffsetOption,
    TopicOption,
    TopicsOption,
    chosen_offsets,
    chosen_poses,
    chosen_topics,
)

OutputOption = Annotated[
    Path,
    typer.Option(
        "-o", "--output", metavar="DIR", help="Output folder: new, empty, or an earlier label set to replace."
    ),
]
ConfidenceOption = Annotated[
    bool,
    typer.Option(
        "--confidence",
        help="Add to each voxel its squared Mahalanobis distance to the driven ground (distance_squared) and, in "
        "profile field, the probability that its label is right (confidence).",
    ),
]


class Solver(StrEnum):
    """The solvers of the surface: near the data, or over whole cubes by Open3D."""

    LATTICE = "lattice"
    OCTREE = "octree"


SolverOption = Annotated[
    Solver, typer.Option(help="Solver of the screened Poisson equation; octree (Open3D) is several times slower.")
]


class Refine(StrEnum):
    """The refinements of poses before labelling."""

    SMALL_GICP = "small_gicp"


RefineOption = Annotated[
    Refine | None,
    typer.Option(
        help="Refine poses by aligning each sweep with the map of the earlier ones; the report lists the changes."
    ),
]


def label(
    bags: RunArgument,
    calibration: CalibrationOption,
    output: OutputOption,
    profile: ProfileOption = DEFAULT_PROFILE,
    parameter: ParameterOption = [],  # noqa: B006
    odometry: OdometryOption = None,
    lidar: LidarOption = None,
    topics: TopicsOption = None,
    topic: TopicOption = [],  # noqa: B006
    workers: WorkersOption = None,
    solver: SolverOption = Solver.LATTICE,
    refine: RefineOption = None,
    ground: GroundOption = Ground.GIVEN,
    grid: GridsOption = [],  # noqa: B006
    time_offset: TimeOffsetOption = [],  # noqa: B006
    clock_offset: ClockOffsetOption = [],  # noqa: B006
    poses: PosesOption = None,
    poses_frame: PosesFrameOption = "",
    confidence: ConfidenceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Label every frame of a recording: free, traversable, potentially traversable or not, voxel by voxel.

    Several recordings of one run (separate sensor files, or a split run) are joined first; their clock offsets are
    measured and reported.
    """
    from services.ingest.pipeline import SynchroniseOptions
    from services.ingest.sequence import OpenedSequence, with_sequence
    from services.labeler.early_ground import require_early_ground
    from services.labeler.local_run import FURTHER, JOINED_RUN, LabelOptions
    from services.labeler.local_run import label as label_sequence
    from services.labeler.parameters import RefinementParameters
    from services.labeler.parameters import chosen_parameters as label_parameters
    from services.labeler.process_pool import begin_loading
    from services.labeler.report import LabelReport
    from stone_files.grid_file import chosen_grids

    begin_loading()
    with reported() as progress:
        chosen = chosen_topics(topics, topic).topics
        sources = SynchroniseOptions(odometry, lidar, topics=chosen, ground=ground.value, progress=progress)
        sources = replace(sources, time_offsets_ns=chosen_offsets(time_offset), poses_frame=poses_frame)
        sources = replace(sources, poses=chosen_poses(poses, poses_frame, odometry))
        refinement = RefinementParameters(refine.value) if refine else None
        parameters = label_parameters(profile.value, chosen_parameters(parameter), chosen_grids(grid))
        parameters = replace(parameters, confidence=confidence, refinement=refinement)
        parameters = replace(parameters, surface=replace(parameters.surface, solver=solver.value))
        recordings = RunRecordings(bags, clock_offset, calibration, lambda: sources)
        with run_of(recordings) as run:
            kept = output / JOINED_RUN if run.joined else run.bag
            source = {"recording": str(kept.resolve()), "calibration": str(calibration.resolve())}
            if ground is Ground.GIVEN:
                require_early_ground(run.bag, calibration, sources.asked_topics, parameters)

            def labelled_of(opened: OpenedSequence) -> LabelReport:
                late = (opened.recording_inputs, opened.late_findings)
                options = LabelOptions(parameters, workers or cores(), source, *late, run.joined)
                return label_sequence(opened.sequence, opened.sweeps, output, options, progress)

            record = with_sequence(run.bag, calibration, run.name, sources, labelled_of).as_record()
    if as_json:
        echo_json(record)
    else:
        labelled = f"{counted(record['frames'], 'frame')} labelled, {len(record['excluded'])} excluded"
        title = f"{labelled}: share of occupied voxels"
        show(class_table(title, record["class_share_of_occupied"]))
        typer.echo(_held_out_line(record["held_out"]))
        typer.echo(f"Labels: {output}\nPicture: {output / 'bev.png'}")
        for other in record["further_grids"]:
            typer.echo(f"Labels at grid {other}: {output / FURTHER / other}")
    findings = [Finding(**finding) for finding in record["findings"]]
    echo_findings(findings)
    if not as_json:
        echo_explainer(findings)


def _held_out_line(held_out: Mapping[str, Any]) -> str:
    """Return a sentence on how well labels from one half of the track hold on the other half."""
    if held_out["recall"] is None:
        return "Held-out track: too little driven ground to judge labels made from one half of it by the other half"
    judged = f"{100 * held_out['recall']:.1f} % of {held_out['judged_m']:.0f} m that the robot drove over"
    return f"Held-out track: {judged} is T or P in labels made from the other half"
