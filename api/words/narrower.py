"""Words of fields that mean something narrower in some schemas than elsewhere."""

from collections.abc import Mapping


def _of(schemas: str, **words: str) -> dict[str, str]:
    return {f"{schema}.{field}": sentence for schema in schemas.split() for field, sentence in words.items()}


_JOBS = "JobItem JobDetail AdminJobItem AdminJobDetail JobGlance"
_SUBMISSIONS = "SubmissionItem SubmissionDetail"
_BENCHMARKS = "BenchmarkItem BenchmarkDetail CreatedBenchmark NewBenchmarkBody"
_PHASES = "PhaseItem PhaseDetail NewPhaseBody AddedPhaseBody"

NARROWER: Mapping[str, str] = {
    **_of(_JOBS, state="State: queued, running, succeeded, failed or cancelled.", kind="Kind of job or run."),
    **_of("RunningAttempt StageItem", kind="Kind of job."),
    **_of(
        "DatasetImportItem DatasetImportDetail ImportedSceneItem ExportItem LabelComparisonItem",
        state="State of the job: queued, running, succeeded, failed or cancelled.",
    ),
    **_of(
        f"{_SUBMISSIONS} ValidationReport",
        state="State: draft, queued, scoring, scored, valid (only checked), invalid, failed or cancelled.",
    ),
    **_of(f"{_SUBMISSIONS} ResultsAnswer MovedItem", kind="Kind: entry, baseline or validation."),
    **_of(_BENCHMARKS, name="Name of the benchmark in paths.", title="Title of the benchmark."),
    **_of("BenchmarkItem", phases="Names of the phases."),
    **_of("BenchmarkDetail CreatedBenchmark", phases="Phases of the benchmark."),
    **_of("NewBenchmarkBody", phases="Phases (default: an open `val` and a hidden `test`)."),
    **_of(_PHASES, name="Name of the phase in paths.", title="Title of the phase."),
    **_of("PhaseChange", title="Title of the phase."),
    **_of("BenchmarkChange", title="Title of the benchmark."),
    **_of(
        "SequenceItem SequenceDetail NewSequenceBody SequenceChangesBody SceneDetail SplitEntry DatasetMemberItem "
        "DatasetInputItem PhaseInputItem",
        name="Name of the sequence.",
    ),
    **_of("DatasetImportItem DatasetImportDetail NewDatasetImportBody", name="Name of the dataset."),
    **_of("ImportedSceneItem", name="Name of the scene."),
    **_of("ExtraFileItem", name="Path below the dataset's root."),
    **_of("PublishedDataset", name="Name of the dataset version."),
    **_of("GridBody GridItem", name="Name of the grid."),
    **_of("TileItem MeshItem", name="Name of the tile."),
    **_of("ArtefactItem PreviewItem", name="Name of the file."),
    **_of("PartItem", name="Name of the group."),
    **_of("DatasetDetail PublishedDataset", sequences="Sequences of the version."),
    **_of(
        "RecordingItem RecordingDetail",
        files="Files of the recording.",
        state="State: received, registered or refused.",
    ),
    **_of(
        "Sizes SizesAsked",
        train="Number of sequences in train.",
        val="Number of sequences in val.",
        test="Number of sequences in test.",
    ),
    **_of("Shares", train="Shares of train.", val="Shares of val.", test="Shares of test."),
    **_of(
        "SplitsBody SplitsToJudge",
        train="Ids of the sequences in train.",
        val="Ids of the sequences in val.",
        test="Ids of the sequences in test.",
    ),
    **_of("JobDetail AdminJobDetail", stages="Stages of a run; empty for a job within a run."),
    **_of("RescoreDiffAnswer", old="Pair in force; null if there is none.", new="Pair of the re-score."),
    **_of(
        "MovedItem",
        old="Ratios by the old pair; null without a score.",
        new="Ratios by the new pair; null without a score.",
    ),
    **_of("PasswordBody", new="New password."),
    **_of("SplitEntry TallyItem KeyTally CellTally", voxels="Number of labelled voxels by class; null if unknown."),
    **_of(
        "ClassCounts",
        free="Number of free voxels; null if they were not counted.",
        traversable="Number of traversable (T) voxels.",
        potentially_traversable="Number of potentially traversable (P) voxels.",
        non_traversable="Number of non-traversable (N) voxels.",
    ),
    **_of(
        "VoxelRatios",
        traversable="Share of traversable (T) voxels.",
        potentially_traversable="Share of potentially traversable (P) voxels.",
        non_traversable="Share of non-traversable (N) voxels.",
    ),
    **_of("MetricItem", version="Version of the metric.", title="Title of the metric."),
    **_of("DeviceCodesItem", url="URL of the page on which a person types the code."),
    **_of("Liveness", status="Always `ok`."),
    **_of("Readiness", status="Whether the platform can answer: ready or not_ready."),
    **_of("ArchiveItem", format="Format of the archive: tar or zip."),
    **_of("CalibrationItem", format="Format that was recognised."),
    **_of("ExportItem NewExportBody", format="Format of the export."),
    **_of("AuditLine", act="Action, such as `user.change`."),
}
