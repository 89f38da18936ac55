"""An entry of a team that was scored and withdrawn: known to the team and to administrators only."""

from pathlib import Path

from services.domain.benchmarks.phases import evaluation_versions
from services.domain.benchmarks.submissions.score_rows import NewScore, write_score
from services.runtime.orm import SubmissionRow, new_id
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.store import blobs
from tests.services.domain.benchmarks.boards import Made, computed


def scored_entry(platform: Platform, phase_id: str, team_id: str, user_id: str) -> dict[str, str]:
    """Its id, also as either side of a comparison."""
    record, confusions, draws = computed(Made())
    files = [blobs.prepare(platform.store, platform.database, _written(platform, one)) for one in (confusions, draws)]
    with platform.database.transaction() as session:
        pair = evaluation_versions.active(session, phase_id)
        assert pair is not None
        row = SubmissionRow(
            id=new_id(), phase_id=phase_id, team_id=team_id, user_id=user_id, method="Net", modality="C+L"
        )
        row.declared_sha256, row.size_bytes, row.state = "8" * 64, 100, "scored"
        row.finalized_ns, row.settled_ns, row.withdrawn_ns = now_ns(), now_ns(), now_ns()
        session.add(row)
        session.flush()
        write_score(session, NewScore(row.id, pair, "metric:a|truth:5", record, files[0], files[1], new_id() * 2))
        row.blob_sha256 = files[0].sha256  # in place of its zip
        return dict.fromkeys(("scored_submission", "a", "b"), row.id)


def _written(platform: Platform, content: bytes) -> Path:
    path = platform.settings.root / f"made-{new_id()}"
    path.write_bytes(content)
    return path
