"""Files that a finished run publishes besides those of its stages: the report, the frame table, facts for rows."""

from dataclasses import asdict

from services.labeler.child_answers import PackAnswer, PublicationAnswer, TotalsAnswer
from services.labeler.exports.source import REPORT, TABLE
from services.labeler.report import report_of
from services.labeler.results import load_pack, pack_path
from services.labeler.run import LabelRun, Part, parts_of
from services.labeler.scratch import whole
from services.labeler.tables import write_frames
from services.labeler.totals import recorded_track, totals_of
from stone_base.label_quality import quality_of
from stone_files.grid_file import GRID_FILE, grid_text

PUBLISHED = "published"


def publication(run: LabelRun) -> PublicationAnswer:
    """Write report, frame table and grid into the folder `published` of scratch, and return the facts for rows."""
    report, out = report_of(run), run.scratch / PUBLISHED
    quality = quality_of(report.as_record())
    with whole(out / REPORT) as staging:
        staging.write_text(report.text())
    with whole(out / TABLE) as staging:
        write_frames(staging, run.sequence, report.counts)
    with whole(out / GRID_FILE) as staging:
        staging.write_text(grid_text(run.parameters.grid))
    frames = run.sequence.frames
    return PublicationAnswer(
        tokens=list(frames.tokens),
        stamps_ns=frames.stamps_ns.tolist(),
        packs=[_pack(run, part) for part in parts_of(run)],
        totals=TotalsAnswer(**totals_of(run), **asdict(quality), track=recorded_track(run.sequence)),  # type: ignore[arg-type]
    )


def _pack(run: LabelRun, part: Part) -> PackAnswer:
    path, (index, _) = pack_path(run, part), load_pack(run, part)
    return PackAnswer(name=f"{path.parent.name}/{path.name}", first=part[0], ranges=index.ranges())
