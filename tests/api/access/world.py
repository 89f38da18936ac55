"""One of everything that somebody can own, as it stands in the database, the store and the uploads folder.

**Conventions.** `World.named` holds a value for every parameter of a path and every id of a body; `UNKNOWN` holds
values of the same form that name nothing.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.domain.benchmarks.phases.ground_truths import first_activation
from services.domain.benchmarks.phases.phases import NewBenchmark, NewPhase, create_benchmark, create_phase
from services.domain.benchmarks.teams import teams
from services.domain.datasets.queries import dataset_named
from services.domain.sequences.profiles import profile_of
from services.runtime.access.issuing import TokenRequest, authority_for, issue_token
from services.runtime.orm import (
    CalibrationRow,
    GroundTruthRow,
    JobLine,
    Preview,
    ProfileRow,
    SequenceRow,
    Team,
    TeamMember,
    Upload,
    User,
    new_id,
)
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.store import blobs
from stone.scoring.metric import METRIC_VERSION
from testing.api.serving import Person
from testing.worlds import made
from testing.worlds.published import dataset, published_sequence
from testing.worlds.rows import recording_of
from tests.api.access.imported import imported
from tests.api.access.rescored import rescored
from tests.api.access.scored_entry import scored_entry
from tests.api.access.submitted import submitted
from tests.api.inputs_made import made_input, made_version_input

CALIBRATION_FILE = Path(__file__).resolve().parents[3] / "examples" / "kitti0005.calibration.yaml"
IDS = (
    "sequence_id", "calibration_id", "recording_id", "job_id", "upload_id", "token_id", "user_id", "token", "export_id",
    "comparison_id", "a_id", "b_id", "phase_id", "team_id", "invitation_id", "truth_id", "rescore_id", "alarm_id",
    "submission_id", "submission_upload", "import_id", "dataset_upload", "settled_submission", "scored_submission",
    "label_set_id",
)  # fmt: skip
UNKNOWN = {name: f"{number:032x}" for number, name in enumerate(IDS, 1)} | {"complete_upload": f"{99:032x}"}
UNKNOWN |= {name: UNKNOWN["scored_submission"] for name in ("a", "b")}
UNKNOWN |= {"dataset_name": "never-published", "benchmark_name": "never-made"}
WORDS = {
    "name": "bev.png", "code": "not_found", "act": "cancel", "queue": "labeler", "platform_name": "warthog",
    "path": "mesh.ply", "part": "train", "sequence_name": "n-forest-07", "phase_name": "test", "metric": METRIC_VERSION,
    "member": "ada", "tile_name": "0_-1", "channel": "CAM_FRONT",
}  # fmt: skip
PUBLIC = ("dataset_name", "benchmark_name", "phase_id")


@dataclass(frozen=True)
class World:
    """What somebody owns: `named` by the names of parameters, `ids` all that may be seen by nobody else."""

    named: Mapping[str, str]
    ids: frozenset[str]


def make_world(platform: Platform, user: User, published: str = "") -> World:
    """A sequence that is ready to be processed again and has labels, and whatever else there is, of this user.

    With `published`, the name of a version of another world, none is made: for whoever leaves versions alone.
    """
    owner = Person(user.id, user.name, "")
    calibration_id = _calibration(platform, user.id)
    sequence_id = _sequence(platform, user.id, calibration_id)
    _profile(platform, user.id)
    named_so = {"id": sequence_id, "name": _name(platform, sequence_id), "owner_id": user.id}
    earlier = made.labels(platform, named_so, seed=b"earlier", contents=[made.frame_labels(2)] * 3)
    labels = made.labels(platform, named_so, contents=[made.frame_labels()] * 3)
    named = {
        "sequence_id": sequence_id,
        "calibration_id": calibration_id,
        "recording_id": _recording(platform, owner, sequence_id),
        "job_id": _run_that_speaks(platform, owner),
        "upload_id": made.upload(platform, owner, b"", state="open", length_bytes=6, purpose="calibration", sha256=""),
        "complete_upload": made.upload(platform, owner, new_id().encode()),
        "token_id": _token(platform, user),
        "user_id": user.id,
        "token": next(iter(labels.frames)),
        "dataset_name": (dataset_name := published or _dataset(platform, owner)),
        "benchmark_name": (benchmark_name := f"stone-{new_id()[-8:]}"),
        "phase_id": _phase(platform, user.id, dataset_name, benchmark_name),
        "export_id": made.export(platform, sequence_id, {"mesh.ply": b"ply\n"}),
        "comparison_id": made.label_comparison(platform, sequence_id, (labels.id, earlier.id)),
        "label_set_id": earlier.id,
        "a_id": labels.id,
        "b_id": earlier.id,
        **_team(platform, user),
        **WORDS,
        "member": user.name,
    }
    made.playback(platform, sequence_id, list(labels.frames))
    named |= imported(platform, owner)
    named |= rescored(platform, named["phase_id"], user.id)
    named |= scored_entry(platform, named["phase_id"], named["team_id"], user.id)
    named |= submitted(platform, named["phase_id"], named["team_id"], owner)
    known = {value for key, value in named.items() if key not in (*WORDS, *PUBLIC)}
    return World(named, frozenset(known | {labels.id, _name(platform, sequence_id), *labels.frames}))


def _dataset(platform: Platform, owner: Person) -> str:
    """A version of sequences that nothing else names: who publishes them tells of them.

    Train's has inputs; of val's and test's they can be made, since they have a recording.
    """
    train, val, test = (published_sequence(platform, owner.user_id) for _ in range(3))
    for recorded in (val, test):
        _recording(platform, owner, recorded)
    with platform.database.transaction() as session:
        _take_name(session, owner.user_id, train)
    name = dataset(platform, owner.user_id, {"train": [train], "val": [val], "test": [test]})
    with platform.database.reading() as session:
        version = dataset_named(session, name)
        assert version is not None
    made_version_input(platform, version.id, WORDS["sequence_name"], {"samples/LIDAR_TOP/sweep.pcd.bin": b"points"})
    return name


def _take_name(session: Session, owner_id: str, sequence_id: str) -> None:
    """Call the sequence what paths say, and that of an earlier world of this owner something else."""
    named = select(SequenceRow).where(SequenceRow.owner_id == owner_id, SequenceRow.name == WORDS["sequence_name"])
    for earlier in session.scalars(named):
        earlier.name = f"n-{earlier.id}"
    session.flush()
    session.get_one(SequenceRow, sequence_id).name = WORDS["sequence_name"]


def _phase(platform: Platform, owner_id: str, dataset_name: str, name: str) -> str:
    """A hidden phase over test with a ground truth in force, as far as it is told of.

    Inputs are there of another sequence, so that those of test's can be asked for.
    """
    manifest = _written(platform, b'{"stone_manifest": 1, "sequences": {}}')
    with platform.database.transaction() as session:
        version = dataset_named(session, dataset_name)
        assert version is not None
        benchmark = create_benchmark(session, NewBenchmark(name, "STONE", "", owner_id))
        phase = create_phase(session, benchmark, version, NewPhase("test", "test", is_hidden=True))
        truth = GroundTruthRow(
            phase_id=phase.id, number=1, dataset_id=version.id, part="test", mask="all", sha256="5" * 64
        )
        truth.manifest_sha256, truth.created_by = blobs.keep(session, platform.store, manifest).sha256, owner_id
        truth.ready_ns, truth.frames = now_ns(), 100
        session.add(truth)
        session.flush()
        first_activation(session, truth)
    made_input(platform, phase.id, WORDS["sequence_name"], {"samples/LIDAR_TOP/sweep.pcd.bin": b"points"})
    return phase.id


def _team(platform: Platform, user: User) -> dict[str, str]:
    """A team that the user leads, with an open invitation; they may lead more than one may found."""
    with platform.database.transaction() as session:
        team = Team(name=f"team-{new_id()[-12:]}")
        session.add(team)
        session.flush()
        session.add(TeamMember(team_id=team.id, user_id=user.id, is_owner=True))
        session.flush()
        return {"team_id": team.id, "invitation_id": teams.invite_row(session, team, user.id)[0].id}


def _calibration(platform: Platform, owner_id: str) -> str:
    path = _written(platform, CALIBRATION_FILE.read_bytes() + f"# {new_id()}\n".encode())
    with platform.database.transaction() as session:
        blob = blobs.keep(session, platform.store, path)
        row = CalibrationRow(owner_id=owner_id, name=f"rig-{new_id()[-8:]}", version=1, filename="rig.yaml")
        row.sha256, row.blob_sha256, row.sensors, row.findings = blob.sha256, blob.sha256, [], []
        session.add(row)
        session.flush()
        return row.id


def _sequence(platform: Platform, owner_id: str, calibration_id: str) -> str:
    with platform.database.transaction() as session:
        row = SequenceRow(owner_id=owner_id, name=f"forest-{new_id()[-8:]}", calibration_id=calibration_id)
        session.add(row)
        session.flush()
        return row.id


def _profile(platform: Platform, owner_id: str) -> None:
    with platform.database.transaction() as session:
        if profile_of(session, owner_id, WORDS["platform_name"]) is None:  # a second world of the same user
            session.add(ProfileRow(owner_id=owner_id, platform=WORDS["platform_name"], topics={"lidar": "/points"}))


def _name(platform: Platform, sequence_id: str) -> str:
    with platform.database.reading() as session:
        return session.get_one(SequenceRow, sequence_id).name


def _recording(platform: Platform, owner: Person, sequence_id: str) -> str:
    path = _written(platform, new_id().encode())
    upload_id = made.upload(platform, owner, path.read_bytes(), state="consumed")
    with platform.database.transaction() as session:
        blob = blobs.keep(session, platform.store, path)
        row = recording_of(session.get_one(Upload, upload_id), sequence_id, "registered", blob.sha256)
        row.inspection = {"topics": []}
        session.add(row)
        session.flush()
        preview = Preview(sequence_id=sequence_id, recording_id=row.id, name=WORDS["name"], media_type="image/png")
        preview.blob_sha256, preview.size_bytes = blob.sha256, blob.size_bytes
        session.add(preview)
        return row.id


def _run_that_speaks(platform: Platform, owner: Person) -> str:
    job_id = made.run(platform, owner, "ingest.register")
    with platform.database.transaction() as session:
        session.add(JobLine(job_id=job_id, attempt=1, number=0, level="info", event="said", facts={}))
    return job_id


def _token(platform: Platform, user: User) -> str:
    with platform.database.transaction() as session:
        return issue_token(session, authority_for(user, 1000.0), TokenRequest("laptop", frozenset({"read"})))[0].id


def _written(platform: Platform, content: bytes) -> Path:
    path = platform.settings.root / f"made-{new_id()}"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return path
