"""A re-score of a phase that is ready to be activated, and an alarm, as rows."""

from services.domain.benchmarks.phases.evaluation_versions import EvaluationVersion
from services.domain.benchmarks.rescores.rescore import NewRescore, start_rescore
from services.runtime.orm import Alarm, GroundTruthRow, Phase, new_id
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from stone.scoring.metric import METRIC_VERSION


def rescored(platform: Platform, phase_id: str, user_id: str) -> dict[str, str]:
    """The ids of another ground truth of the phase, of the re-score by it, and of an alarm."""
    with platform.database.transaction() as session:
        phase = session.get_one(Phase, phase_id)
        truth = GroundTruthRow(
            phase_id=phase.id, number=2, dataset_id=phase.dataset_id, part=phase.part, mask=phase.mask
        )
        truth.created_by, truth.ready_ns = user_id, now_ns()
        session.add(truth)
        session.flush()
        asked = NewRescore(EvaluationVersion(truth.id, METRIC_VERSION), user_id, "labels corrected")
        rescore, _run = start_rescore(session, phase, asked)
        alarm = Alarm(phase_id=phase.id, kind="equal_content", subject=new_id(), facts={"team": "Forest", "others": []})
        session.add(alarm)
        session.flush()
        return {"truth_id": truth.id, "rescore_id": rescore.id, "alarm_id": alarm.id}
