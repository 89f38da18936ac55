"""The commands that talk to a server, against the real API on a real socket."""

import json
import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pytest
from structlog.testing import capture_logs
from typer.testing import CliRunner, Result

from services.ingest.stages import handlers
from services.runtime.access.passwords import hash_password
from services.runtime.jobs.enqueue import enqueue
from services.runtime.jobs.execution import run_next
from services.runtime.jobs.specs import Attempt, Context, JobSpec, Outcome
from services.runtime.orm import Job, User
from services.runtime.platform import Platform
from simulator.options import SimulateOptions
from simulator.pipeline import simulate
from stone.errors import StoneError
from stone_client.main import app
from testing.api.serving import Person, client_of, person, serving
from testing.stone_serve import until
from testing.worlds import made
from tests.working import working

PASSWORD = "correct horse battery staple"


class MuddyError(StoneError):
    code = "muddy"


def stone(*arguments: str | Path, stdin: str = "") -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments], input=stdin)


@pytest.fixture
def owner(platform: Platform) -> Person:
    return person(platform, "curator", "ada")


@pytest.fixture
def url(platform: Platform) -> Iterator[str]:
    with serving(platform) as address:
        yield address


@pytest.fixture(autouse=True)
def nobody(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("STONE_URL", "STONE_TOKEN"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("STONE_CONFIG_HOME", str(tmp_path / "configuration"))


@pytest.fixture(autouse=True)
def _silence() -> Iterator[None]:
    """The server's log lines stay out of the command's stdout: both are in this process."""
    with capture_logs():
        yield


@pytest.fixture
def as_owner(url: str, owner: Person, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv("STONE_URL", url)
    monkeypatch.setenv("STONE_TOKEN", owner.secret)
    return url


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "run.mcap"
    simulate(path, SimulateOptions(seconds=1.0, channels=16, columns=180, cameras=False))
    return path


def ingesting(platform: Platform) -> AbstractContextManager[None]:
    """A worker of the queue `ingest` in a thread."""
    return working(platform, "ingest", handlers)


def uploaded(platform: Platform, bag: Path, *options: str) -> Result:
    with ingesting(platform):
        return stone("upload", bag, "--calibration", bag.with_suffix(".calibration.yaml"), *options)


def job_of(platform: Platform, owner: Person, kind: str) -> str:
    with platform.database.transaction() as session:
        return enqueue(session, JobSpec(kind), Context(owner.user_id)).id


def refused(result: Result) -> str:
    """The refusal's code; a traceback is none."""
    assert result.exit_code == 1, (result.stdout, result.stderr, result.exception)
    return result.stderr.rstrip("\n").splitlines()[-1].partition(":")[0]


def test_without_a_login_nothing_is_asked(bag: Path) -> None:
    for command in (["status"], ["process", "run"], ["watch", "run"], ["download", "run", "-o", "x"]):
        assert refused(stone(*command)) == "no_server"


def test_a_token_that_is_not_known_is_refused(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STONE_TOKEN", "stone_" + "x" * 43)
    assert refused(stone("status", "--server", url)) == "unauthenticated"


def test_a_wrong_password_is_refused_and_nothing_is_kept(url: str, owner: Person, tmp_path: Path) -> None:
    assert refused(stone("login", url, "--name", "ada", "--password-stdin", stdin="guess\n")) == "wrong_password"
    assert not (tmp_path / "configuration").exists()


def test_what_is_not_yours_is_not_found(platform: Platform, as_owner: str) -> None:
    stranger = person(platform, "curator")
    with client_of(platform) as api:
        theirs = made.sequence(api, stranger, "secret")
    assert refused(stone("status", "secret")) == "not_found"
    assert refused(stone("process", theirs["id"])) == "not_found"
    assert refused(stone("watch", job_of(platform, stranger, "ingest.register"))) == "not_found"
    assert "secret" not in stone("status").stdout


def test_a_participant_may_not_upload(platform: Platform, url: str, bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STONE_TOKEN", person(platform, "participant").secret)
    assert refused(uploaded(platform, bag, "--server", url)) == "forbidden"


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
    assert refused(stone("process", "bare")) == "no_calibration"
    assert refused(stone("watch", "bare")) == "not_found"
    assert refused(stone("download", "bare", "-o", "absent")) == "no_labels"


def test_a_job_that_fails_is_exit_code_1_with_its_code_and_reason(
    platform: Platform, as_owner: str, owner: Person
) -> None:
    def fail(attempt: Attempt) -> Outcome:
        raise MuddyError("the ditch is 2 m deep")

    job_id = job_of(platform, owner, "eval.drive")
    said: list[Result] = []
    watching = threading.Thread(target=lambda: said.append(stone("watch", job_id)))
    watching.start()
    run_next(platform, "eval", {"eval.drive": fail})
    watching.join()
    assert refused(said[0]) == "muddy"
    assert "the ditch is 2 m deep" in said[0].stderr


def test_a_password_becomes_a_token_that_the_other_commands_use(platform: Platform, url: str, owner: Person) -> None:
    with platform.database.transaction() as session:
        session.get_one(User, owner.user_id).password_hash = hash_password(PASSWORD)
    signed_in = stone("login", url, "--name", "ada", "--password-stdin", "--json", stdin=PASSWORD + "\n")
    assert signed_in.exit_code == 0, signed_in.stderr
    assert json.loads(signed_in.stdout)["scopes"] == ["read", "submit", "upload"]
    assert json.loads(stone("status", "--json").stdout) == {"sequences": []}


def test_a_token_can_be_given_instead(url: str, owner: Person) -> None:
    signed_in = stone("login", url, "--token-stdin", stdin=owner.secret + "\n")
    assert signed_in.exit_code == 0, signed_in.stderr
    assert signed_in.stdout.startswith(f"ada (curator) at {url}")
    assert stone("status").exit_code == 0


def test_an_upload_makes_the_sequence_and_says_what_comes_next(platform: Platform, as_owner: str, bag: Path) -> None:
    outcome = uploaded(platform, bag, "--name", "forest", "--json")
    assert outcome.exit_code == 0, outcome.stderr
    record = json.loads(outcome.stdout)
    shown: dict[str, Any] = json.loads(stone("status", "forest", "--json").stdout)
    assert (shown["id"], shown["calibration_id"]) == (record["sequence"], record["calibration"])
    assert [(one["sha256"], one["state"]) for one in shown["recordings"]] == [(record["sha256"], "registered")]
    again = uploaded(platform, bag, "--name", "forest")
    assert again.exit_code == 0, again.stderr
    assert "upload" not in again.stderr, "nothing was sent"
    assert "Next: stone process forest --watch" in again.stdout


def test_asked_twice_a_sequence_is_processed_once(platform: Platform, as_owner: str, bag: Path) -> None:
    assert uploaded(platform, bag).exit_code == 0
    runs = [json.loads(stone("process", "run", "--json").stdout) for _ in range(2)]
    assert runs[0]["id"] == runs[1]["id"]
    assert "sequence.process queued" in stone("status").stdout
    shown = json.loads(stone("status", runs[0]["id"], "--json").stdout)
    assert [stage["kind"] for stage in shown["stages"]] == ["ingest.synchronise"]


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
    watching = threading.Thread(target=lambda: said.append(stone("watch", job_id, "--json")))
    watching.start()
    worker = threading.Thread(target=lambda: run_next(platform, "eval", {"eval.drive": drive}))
    worker.start()
    until(lambda: done_of(platform, job_id) == 7)  # not by a command: two at once would share their streams
    is_seen.set()
    worker.join()
    watching.join()
    assert said[0].exit_code == 0, said[0].stderr
    assert "drive 7/7" in said[0].stderr
    assert json.loads(said[0].stdout)["result"] == {"metres": 7}
    assert "arrived" in stone("status", job_id).stdout


def test_labels_arrive_as_they_are_on_the_server(
    platform: Platform, as_owner: str, owner: Person, tmp_path: Path
) -> None:
    with client_of(platform) as api:
        sequence = made.sequence(api, owner, "forest")
    labels = made.labels(platform, sequence, frames=3)
    outcome = stone("download", "forest", "-o", tmp_path / "labels", "--json")
    assert outcome.exit_code == 0, outcome.stderr
    assert json.loads(outcome.stdout)["frames"] == 3
    for name in ("report.json", "bev.png", "mesh.ply", "frames.parquet"):
        assert (tmp_path / "labels" / name).read_bytes() == labels.files[name]
    for token, content in labels.frames.items():
        assert (tmp_path / "labels" / "gts" / "forest" / token / "labels.npz").read_bytes() == content
    assert stone("download", "forest", "-o", tmp_path / "labels").exit_code == 0, "an earlier label set is replaced"
    assert refused(stone("download", "forest", "-o", tmp_path)) == "output_exists"
