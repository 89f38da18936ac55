"""The rows behind the golden lists: people, sequences, jobs and labels; what is published is in `published_rows`."""

from dataclasses import dataclass
from typing import Any

from sqlalchemy import insert
from sqlalchemy.orm import Session

from services.runtime.access import roles
from services.runtime.access.issuing import hash_of
from services.runtime.orm import Artefact, Blob, Job, LabelSet, Recording, SequenceRow, SplitMember, Token, User
from services.runtime.platform import Platform
from tests.api.listed.listed_values import EPOCH_NS, FAR_NS, SHA, STATES, at_ns, id_of
from tests.api.listed.published_rows import add_exports, add_submissions, add_versions

SEQUENCES = 7


@dataclass(frozen=True)
class ListedPerson:
    """A user whose token is known."""

    user_id: str
    secret: str

    @property
    def headers(self) -> dict[str, str]:
        return {"Authorization": f"Bearer {self.secret}"}


def fill_listed(platform: Platform) -> dict[str, ListedPerson]:
    """`ada` and `bob` are curators, `root` administrates; their sequences, jobs, exports, submissions, two versions."""
    with platform.database.transaction() as session:
        people = {name: _person(session, number, name) for number, name in enumerate(("ada", "bob", "root"), 1)}
        session.execute(
            insert(Blob), [{"sha256": SHA, "object_key": "blobs/one", "size_bytes": 9, "created_ns": EPOCH_NS}]
        )
        _sequences(session)
        _jobs(session)
        _labels(session)
        add_versions(session)
        add_exports(session)
        add_submissions(session)
    return people


def _person(session: Session, number: int, name: str) -> ListedPerson:
    role = "administrator" if name == "root" else "curator"
    user_id, secret = id_of("user", number), "stone_" + f"{name}-".ljust(43, "x")
    user = {"id": user_id, "name": name, "role": role, "password_hash": "", "is_active": True, "created_ns": EPOCH_NS}
    session.execute(insert(User), [user])
    token = {"id": id_of("token", number), "user_id": user_id, "name": "test", "secret_hash": hash_of(secret)}
    held = {"scopes": sorted(roles.SCOPES_OF[role]), "created_ns": EPOCH_NS, "expires_ns": FAR_NS}
    session.execute(insert(Token), [token | held])
    return ListedPerson(user_id, secret)


def _sequences(session: Session) -> None:
    """Ada's but the last two; one of each is public, one is deleted, and names are not all ASCII."""
    rows = [
        {
            "id": id_of("sequence", number), "owner_id": id_of("user", 1 if number <= 5 else 2),
            "name": f"forest-{number}", "environment": ("forest", "", "mountain")[number % 3],
            "illumination": ("day", "night", "")[number % 3], "region": ("Gyeonggi", "Île-de-France", "")[number % 3],
            "platform": ('warthog "1"', "hüsky <2> & \\", "")[number % 3], "is_public": number in (2, 6),
            "published_ns": at_ns(number) if number in (2, 6) else None, "revision": number,
            "created_ns": at_ns(number), "deleted_ns": at_ns(9) if number == 4 else None,
        }
        for number in range(1, SEQUENCES + 1)
    ]  # fmt: skip
    session.execute(insert(SequenceRow), rows)
    session.execute(insert(Recording), [_recording(number, of) for number, of in enumerate((1, 1, 3), 1)])
    session.execute(insert(SplitMember), [{"sequence_id": id_of("sequence", 1), "part": "val"}])
    session.execute(insert(SplitMember), [{"sequence_id": id_of("sequence", 6), "part": "train"}])


def _recording(number: int, sequence: int) -> dict[str, Any]:
    named = {"id": id_of("recording", number), "sequence_id": id_of("sequence", sequence), "filename": "a.bag"}
    return named | {"size_bytes": 5, "sha256": SHA, "state": "registered", "findings": [], "created_ns": EPOCH_NS}


def _job(number: int, sequence: int, **said: Any) -> dict[str, Any]:
    usual: dict[str, Any] = {
        "id": id_of("job", number), "root_id": id_of("job", number),
        "owner_id": id_of("user", 1 if sequence <= 5 else 2), "sequence_id": id_of("sequence", sequence),
        "kind": "sequence.process", "queue": "", "state": "succeeded", "priority": 0, "arguments": {}, "attempt": 0,
        "done": 0, "total": 0, "stage": "", "failure_code": "", "failure": "", "cancel_reason": "", "revision": number,
        "created_ns": at_ns(number), "started_ns": at_ns(number + 1), "finished_ns": at_ns(number + 3),
    }  # fmt: skip
    return usual | said


def _jobs(session: Session) -> None:
    """A run of each sequence with three jobs; one that is its own run; one of none."""
    runs, parts = [], []
    for number in range(1, SEQUENCES + 1):
        state = STATES[number % len(STATES)]
        begun = {"started_ns": None, "finished_ns": None} if state == "queued" else {}
        failed = {"failure_code": "no_poses", "failure": 'the bag "a" has no odometry'} if state == "failed" else {}
        why = {"cancel_reason": "not now"} if state == "cancelled" else {}
        run = _job(10 * number, number, state=state, **begun, **failed, **why)
        runs.append(run)
        for place, kind in enumerate(("ingest.synchronise", "labeler.fuse", "labeler.surface"), 1):
            of = {"root_id": run["id"], "kind": kind, "queue": "ingest" if place == 1 else "labeler"}
            own = "succeeded" if place == 1 else state
            times = begun if own == "queued" else {}
            parts.append(_job(10 * number + place, number, state=own, attempt=1, **of, **times))
    alone = _job(90, 1, kind="labeler.export", queue="labeler", done=3, total=8, stage="pack", attempt=2)
    runs += [alone, _job(91, 2, kind="ingest.register", sequence_id=None, priority=5)]
    runs.append(_job(92, 1, kind="score", state="running", finished_ns=None, sequence_id=None))
    runs.append(_job(93, 6, kind="labeler.export", queue="labeler", state="failed", failure_code="disk_full"))
    session.execute(insert(Job), runs)
    session.execute(insert(Job), parts)


def _labels(session: Session) -> None:
    """Two of the first, of which the older one counts; of the third an earlier version's; of the sixth one."""
    known = {"duration_ns": 25_100_000_000, "distance_m": 30.5, "t_voxels": 100, "p_voxels": 200, "n_voxels": 700}
    known |= {"held_out_recall": 0.9731, "held_out_m": 75.4, "gravest_code": "LAB-605", "gravest_severity": "warning"}
    unknown = {"duration_ns": 24 * 10**9, "distance_m": None, "t_voxels": None, "p_voxels": None, "n_voxels": None}
    unknown |= dict.fromkeys(("held_out_recall", "held_out_m", "gravest_code", "gravest_severity"))
    rows = [
        _label_set(1, 1, known, chosen_ns=at_ns(50)),
        _label_set(2, 1, known, chosen_ns=at_ns(40)),
        _label_set(3, 3, unknown, chosen_ns=at_ns(30)),
        _label_set(4, 6, known | {"distance_m": 1e-7, "duration_ns": None}, chosen_ns=at_ns(30)),
    ]
    session.execute(insert(LabelSet), rows)
    names = ((1, "bev.png"), (1, "thumbnail.png"), (2, "thumbnail.jpg"), (3, "report.json"), (4, "bev.png"))
    session.execute(insert(Artefact), [_artefact(place, *one) for place, one in enumerate(names, 1)])


def _label_set(number: int, sequence: int, sums: dict[str, Any], chosen_ns: int) -> dict[str, Any]:
    return {
        "id": id_of("labels", number), "sequence_id": id_of("sequence", sequence),
        "job_id": id_of("job", 10 * sequence), "recipe": f"{number:064x}", "parameters": {},
        "code_version": "71299b6a455d", "frames": 10 * number, "created_ns": at_ns(20 + number), "chosen_ns": chosen_ns,
        **sums,
    }  # fmt: skip


def _artefact(number: int, labels: int, name: str) -> dict[str, Any]:
    of = {"id": id_of("artefact", number), "label_set_id": id_of("labels", labels), "name": name}
    return of | {"media_type": "image/png", "blob_sha256": SHA, "size_bytes": 9}
