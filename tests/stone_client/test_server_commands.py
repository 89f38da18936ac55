"""The commands that talk to a server, against the real API on a real socket."""

import json
import threading
from pathlib import Path

import pytest
from typer.testing import Result

from services.domain.notifications.spread import choices_of
from services.eval.queue_handlers import handlers
from services.runtime.access.passwords import hash_password
from services.runtime.jobs.enqueue import enqueue
from services.runtime.jobs.execution import run_next
from services.runtime.jobs.specs import Attempt, Context, JobSpec, Outcome
from services.runtime.orm import Job, User
from services.runtime.platform import Platform
from simulator.options import SimulateOptions
from stone.errors import StoneError
from stone.splits.composition import CatalogueEntry
from stone.splits.rules import check_split
from stone.splits.splits import Split
from stone_client.api import Api
from stone_client.credentials import Server
from stone_client.server.ids import place_from_newest
from stone_client.server.label_sets import compare_label_sets, label_set_table, label_sets_of
from stone_local.demo.benchmark import write_flat_ground
from stone_local.demo.pipeline import TRAIN, VAL, demo_runs, demo_server_of
from stone_submissions.manifest import Manifest, write_manifest
from stone_submissions.validation import validate
from testing.api.serving import Person, client_of, person, serving
from testing.refusals import refused_as
from testing.stone_serve import until
from testing.worlds import made
from testing.worlds.made import frame_labels, labels
from tests.stone_client.participating import answered, ingesting, refused, stone
from tests.working import working

PASSWORD = "correct horse battery staple"


class MuddyError(StoneError):
    code = "muddy"


def uploaded(platform: Platform, bag: Path, *options: str) -> Result:
    with ingesting(platform):
        return stone("sequence", "upload", bag, "--calibration", bag.with_suffix(".calibration.yaml"), *options)


def job_of(platform: Platform, owner: Person, kind: str) -> str:
    with platform.database.transaction() as session:
        return enqueue(session, JobSpec(kind), Context(owner.user_id)).id


def test_without_a_login_nothing_is_asked(bag: Path) -> None:
    for command in (["status"], ["process", "run"], ["watch", "run"], ["download", "run", "-o", "x"]):
        assert refused(stone(*command)) == "no_server"


def test_a_token_that_is_not_known_is_refused(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STONE_TOKEN", "stone_" + "x" * 43)
    assert refused(stone("sequence", "list", "--server", url)) == "unauthenticated"


def test_a_wrong_password_is_refused_and_nothing_is_kept(url: str, owner: Person, tmp_path: Path) -> None:
    assert (
        refused(stone("auth", "login", url, "--name", "ada", "--password-stdin", stdin="guess\n")) == "wrong_password"
    )
    without = stone("auth", "login", url, "--name", "ada", stdin="")
    assert (without.exit_code, "no terminal for a prompt" in without.stderr) == (2, True)
    assert not (tmp_path / "configuration").exists()


def test_a_recording_that_cannot_be_read_is_refused_with_its_own_code(
    platform: Platform, as_owner: str, bag: Path, tmp_path: Path
) -> None:
    (tmp_path / "page.mcap").write_text("<!doctype html><title>Sign in</title>")
    (tmp_path / "page.calibration.yaml").write_bytes(bag.with_suffix(".calibration.yaml").read_bytes())
    outcome = uploaded(platform, tmp_path / "page.mcap", "--json")
    assert refused(outcome) not in ("recording_refused", "internal_error")
    assert "page.mcap" in outcome.stderr
    assert json.loads(outcome.stdout)["findings"][0]["severity"] == "error"


def test_a_sequence_that_lacks_something_is_not_processed(platform: Platform, as_owner: str, owner: Person) -> None:
    with client_of(platform) as api:
        made.sequence(api, owner, "bare")
    assert refused(stone("sequence", "process", "bare")) == "no_calibration"
    assert (
        refused(stone("sequence", "process", "bare", "--parameter", "reference.outlier_ratio=0.25")) == "no_calibration"
    )
    assert (
        refused(stone("sequence", "process", "bare", "--parameter", "reference.outlier_ratio=0.6")) == "bad_parameter"
    )
    assert refused(stone("sequence", "watch", "bare")) == "not_found"
    assert refused(stone("sequence", "download", "bare", "-o", "absent")) == "no_labels"


def test_a_job_that_fails_is_exit_code_1_with_its_code_and_reason(
    platform: Platform, as_owner: str, owner: Person
) -> None:
    def fail(attempt: Attempt) -> Outcome:
        raise MuddyError("the ditch is 2 m deep")

    job_id = job_of(platform, owner, "eval.drive")
    said: list[Result] = []
    watching = threading.Thread(target=lambda: said.append(stone("sequence", "watch", job_id)))
    watching.start()
    run_next(platform, "eval", {"eval.drive": fail})
    watching.join()
    assert refused(said[0]) == "muddy"
    assert "the ditch is 2 m deep" in said[0].stderr


def test_a_password_becomes_a_token_that_the_other_commands_use(platform: Platform, url: str, owner: Person) -> None:
    with platform.database.transaction() as session:
        session.get_one(User, owner.user_id).password_hash = hash_password(PASSWORD)
    assert stone("auth", "login", url, "--name", "ada", stdin=PASSWORD + "\n").exit_code == 0, (
        "without a terminal as well"
    )
    signed_in = stone("auth", "login", url, "--name", "ada", "--password-stdin", "--json", stdin=PASSWORD + "\n")
    assert signed_in.exit_code == 0, signed_in.stderr
    assert json.loads(signed_in.stdout)["scopes"] == ["read", "submit", "upload"]
    assert json.loads(stone("sequence", "list", "--json").stdout) == {"sequences": []}


def done_of(platform: Platform, job_id: str) -> int:
    with platform.database.reading() as session:
        return session.get_one(Job, job_id).done


def test_watching_ends_with_the_job_and_shows_its_stages(platform: Platform, as_owner: str, owner: Person) -> None:
    is_seen = threading.Event()

    def drive(attempt: Attempt) -> Outcome:
        attempt.progress("drive", 7, 7)
        attempt.log("arrived")
        is_seen.wait(300)
        return Outcome({"metres": 7})

    job_id = job_of(platform, owner, "eval.drive")
    said: list[Result] = []
    watching = threading.Thread(target=lambda: said.append(stone("sequence", "watch", job_id, "--json")))
    watching.start()
    worker = threading.Thread(target=lambda: run_next(platform, "eval", {"eval.drive": drive}))
    worker.start()
    until(lambda: done_of(platform, job_id) == 7)  # not by a command: two at once would share their streams
    is_seen.set()
    worker.join()
    watching.join()
    assert said[0].exit_code == 0, said[0].stderr
    assert "eval.drive 7 of 7" in said[0].stderr
    assert json.loads(said[0].stdout)["result"] == {"metres": 7}
    assert "arrived" in stone("sequence", "status", job_id).stdout


def test_labels_arrive_as_they_are_on_the_server(
    platform: Platform, as_owner: str, owner: Person, tmp_path: Path
) -> None:
    with client_of(platform) as api:
        sequence = made.sequence(api, owner, "forest")
    labels = made.labels(platform, sequence, frames=3)
    outcome = stone("sequence", "download", "forest", "-o", tmp_path / "labels", "--json")
    assert outcome.exit_code == 0, outcome.stderr
    assert json.loads(outcome.stdout)["frames"] == 3
    for name in ("report.json", "bev.png", "mesh.ply", "frames.parquet"):
        assert (tmp_path / "labels" / name).read_bytes() == labels.files[name]
    for token, content in labels.frames.items():
        assert (tmp_path / "labels" / "gts" / "forest" / token / "labels.npz").read_bytes() == content
    assert stone("sequence", "download", "forest", "-o", tmp_path / "labels").exit_code == 0, (
        "an earlier label set is replaced"
    )
    assert refused(stone("sequence", "download", "forest", "-o", tmp_path)) == "output_exists"


@pytest.mark.usefixtures("as_owner")
def test_events_are_chosen_by_channel_and_taken_back(platform: Platform, owner: Person) -> None:
    assert refused(stone("notifications", "on", "run.failed", "--by", "email")) == "email_off"
    assert stone("notifications", "on", "run.failed", "phase.opened", "--by", "webhook").exit_code == 0
    assert stone("notifications", "on", "quota.low", "--by", "webhook").exit_code == 0
    told = stone("notifications", "off", "phase.opened", "--by", "webhook")
    assert told.exit_code == 0
    with platform.database.reading() as session:
        assert choices_of(session, owner.user_id) == {"email": [], "webhook": ["run.failed", "quota.low"]}
    listed = json.loads(stone("notifications", "list", "--json").stdout)
    assert (listed["email"], listed["webhook"]) == ([], ["run.failed", "quota.low"])
    assert json.loads(stone("notifications", "deliveries", "--json").stdout) == {"deliveries": []}


@pytest.mark.parametrize(
    ("named", "place"),
    [("latest", 0), ("latest~1", 1), ("latest~0", 0), ("newest", None), ("latest~", None), ("", None)],
)
def test_a_name_by_age_is_a_place_from_the_newest(named: str, place: int | None) -> None:
    assert place_from_newest(named) == place


@pytest.mark.usefixtures("as_owner")
def test_a_label_set_is_deleted_once_it_is_agreed_to(platform: Platform, owner: Person) -> None:
    with client_of(platform) as api:
        sequence = made.sequence(api, owner, "forest")
    earlier, later = (made.labels(platform, sequence, seed=seed).id for seed in (b"1", b"2"))
    assert stone("label-set", "delete", "forest", "latest").exit_code == 2
    assert answered("label-set", "delete", "forest", "latest~1", "--yes") == {"deleted": earlier}
    listed = answered("label-set", "list", "forest")
    assert [one["id"] for one in listed["label_sets"]] == [later]
    assert refused(stone("label-set", "delete", "forest", earlier, "--yes")) == "not_found"


def test_label_sets_are_named_by_id_or_by_age_and_any_other_name_is_refused(platform: Platform) -> None:
    curator = person(platform, "curator")
    with serving(platform) as url, Api(Server(url, curator.secret)) as api:
        made = api.create("/sequences", {"name": "forest"})
        earlier = labels(platform, made, contents=[frame_labels(1)] * 2, seed=b"earlier")
        later = labels(platform, made, contents=[frame_labels(2)] * 2, seed=b"later")
        sets = label_sets_of(api, made["id"])
        assert [one["id"] for one in sets] == [later.id, earlier.id]
        cells = [list(column.cells) for column in label_set_table("forest", sets).columns[3:5]]
        assert cells == [["97.3 %"] * 2, ["LAB-605"] * 2]
        for named in ("latest~2", "yesterday's"):
            with refused_as("no_label_set", match=r"give an id, or latest, .* \(this sequence has 2"):
                compare_label_sets(api, made, ("latest", named), lambda *_: None)
        with working(platform, "eval", handlers):
            compared = compare_label_sets(api, made, ("latest", earlier.id), lambda *_: None)
        assert (compared["a_id"], compared["b_id"], compared["record"]["frames"]) == (later.id, earlier.id, 2)


@pytest.mark.parametrize(("role", "administers"), [("administrator", True), ("curator", False)])
def test_the_benchmark_is_made_by_whoever_may_administrate(platform: Platform, role: str, administers: bool) -> None:
    somebody = person(platform, role)
    with serving(platform) as url:
        place = demo_server_of(Server(url, somebody.secret))
        assert place.server == Server(url, somebody.secret)
        with place.administering() as api:
            assert (api is not None) == administers
            if api is not None:
                assert api.read("/me")["role"] == role


def test_the_runs_have_their_conditions_and_no_rule_of_the_splits_is_broken() -> None:
    runs, said = demo_runs(SimulateOptions()), ("environment", "illumination", "region")
    catalogue = tuple(
        CatalogueEntry(run.name, run.name, *(run.conditions[one] for one in said), run.simulation.seconds, frames=1)
        for run in runs
    )
    parts = {part: tuple(run.name for run in runs if run.part == part) for part in (TRAIN, VAL)}
    assert {part: len(names) for part, names in parts.items()} == {TRAIN: 1, VAL: 2}
    assert all(all(run.conditions.values()) for run in runs)
    assert [one for one in check_split(Split(**parts), catalogue) if one.severity == "error"] == []


def test_a_run_that_is_too_short_for_a_split_stays_alone() -> None:
    assert [run.name for run in demo_runs(SimulateOptions(seconds=2.0))] == ["demo"]


def test_flat_ground_is_a_valid_submission(tmp_path: Path) -> None:
    tokens = tuple(f"{number:032x}" for number in range(3))
    write_manifest(tmp_path / "manifest.json", Manifest({"demo-dusk": tokens}))
    write_flat_ground(tmp_path / "manifest.json", tmp_path / "flat.zip")
    assert validate(tmp_path / "flat.zip", tmp_path / "manifest.json").ok
