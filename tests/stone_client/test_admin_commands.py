"""`stone admin` against the real API: users, teams, tokens, jobs, the audit log, benchmarks from a file, re-scores."""

import json
from pathlib import Path
from typing import Any

import pytest

from services.domain.benchmarks.teams import teams
from services.runtime.access.passwords import verify_password
from services.runtime.access.users import find_user
from services.runtime.orm import Benchmark, Job, Phase, Rescore, Team, User
from services.runtime.platform import Platform
from stone_client.admin_tree import ADMIN
from stone_client.command_tree import leaves
from testing.api.serving import person
from testing.worlds.benchmark_world import World
from tests.stone_client.participating import Served, answered, joined, refused, scoring, stone, zipped

PASSWORD = "correct horse battery staple"
WHY = ("--reason", "a test")


@pytest.fixture
def served(served_world: tuple[World, str], monkeypatch: pytest.MonkeyPatch) -> Served:
    """As the administrator of a platform with a benchmark."""
    made = joined(*served_world)
    monkeypatch.setenv("STONE_URL", made.url)
    monkeypatch.setenv("STONE_TOKEN", made.world.administrator.secret)
    return made


def audited(act: str) -> list[dict[str, Any]]:
    return list(answered("admin", "audit", "--act", act)["entries"])


def test_users_are_added_changed_and_deleted(served: Served) -> None:
    added = stone("admin", "users", "add", "eve", "--role", "curator", "--password-stdin", *WHY, stdin=f"{PASSWORD}\n")
    assert added.exit_code == 0, added.stderr
    with served.platform.database.reading() as session:
        user = find_user(session, "eve")
        assert user is not None
        assert verify_password(user.password_hash, PASSWORD)
        assert user.id in added.stdout
    assert answered("admin", "users", "role", "eve", "participant", *WHY)["role"] == "participant"
    assert [one["name"] for one in answered("admin", "users", "list", "--name", "eve")["users"]] == ["eve"]
    assert stone("admin", "users", "deactivate", "eve", *WHY).exit_code == 2
    assert answered("admin", "users", "deactivate", "eve", *WHY, "--dry-run")["dry_run"]
    assert not answered("admin", "users", "deactivate", "eve", *WHY, "--yes")["is_active"]
    assert answered("admin", "users", "reactivate", user.id, *WHY)["is_active"]
    assert stone("admin", "users", "delete", "eve", *WHY, stdin="y\n").exit_code == 2
    assert stone("admin", "users", "delete", "eve", *WHY, "--yes").exit_code == 0
    assert refused(stone("admin", "users", "role", "eve", "curator", *WHY)) == "unknown_user"
    assert [line["reason"] for line in audited("user.erase")] == ["a test"]


def test_a_users_tokens_are_revoked(served: Served) -> None:
    name = served.captain.name
    (token,) = answered("admin", "tokens", "list", name)["tokens"]
    assert stone("admin", "tokens", "revoke", name, token["id"], *WHY).exit_code == 2
    assert answered("admin", "tokens", "revoke", name, token["id"], *WHY, "--yes")["tokens"] == 1
    assert answered("admin", "tokens", "list", name)["tokens"] == []


def test_a_team_gets_another_captain_and_more_submissions(served: Served) -> None:
    member = person(served.platform, "participant")
    with served.platform.database.transaction() as session:
        team = session.get_one(Team, served.team_id)
        _, secret = teams.invite_row(session, team, served.captain.user_id, 10**12)
        teams.join(session, secret, session.get_one(User, member.user_id))
    assert answered("admin", "teams", "captain", served.team, member.name, *WHY)["captain"] == member.name
    left = answered("admin", "teams", "remove", served.team, served.captain.name, *WHY)
    assert left["members"] == [member.name]
    assert served.team_id in {one["id"] for one in answered("admin", "teams", "list")["teams"]}
    granted = answered("admin", "teams", "grant", served.team, *served.at("test"), "--submissions", 2, *WHY)
    assert granted["scorings"] == 2


def test_jobs_are_listed_and_acted_on_and_refusals_are_exit_code_1(served: Served) -> None:
    with served.platform.database.reading() as session:
        job = session.query(Job).filter(Job.state == "succeeded").first()
        assert job is not None
    assert answered("admin", "jobs", "list", "--limit", 1)["jobs"]
    done = stone("admin", "jobs", "cancel", job.root_id, *WHY, "--json")
    assert done.exit_code == 1
    (one,) = json.loads(done.stdout)["jobs"]
    assert one["failure"]["code"]
    assert answered("admin", "jobs", "show", job.root_id[-12:])["id"] == job.root_id
    assert job.root_id in stone("admin", "jobs", "show", job.root_id).stdout.replace("\n", "")
    assert refused(stone("admin", "jobs", "show", "ffffffffffff")) == "not_found"
    assert answered("admin", "workers")["workers"] == []
    switched = answered("admin", "queues", "pause", "labeler", *WHY)["queues"]
    assert [queue["mode"] for queue in switched] == ["paused"]
    assert answered("admin", "queues", "resume", "labeler", *WHY)["queues"][0]["mode"] == "open"
    assert {queue["name"] for queue in answered("admin", "queues", "list")["queues"]} >= {"ingest", "labeler", "eval"}
    assert answered("admin", "audit", "--verify")["is_whole"]


def described(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_a_benchmark_is_applied_from_a_file_and_again_without_a_change(served: Served, tmp_path: Path) -> None:
    dataset = answered("benchmark", "list", served.world.benchmark)["benchmarks"][0]["phases"][0]["dataset"]
    text = f"""
name: season
title: First season
dataset: {dataset}
is_public: true
phases:
  val: {{part: val, is_hidden: false}}
  test:
    part: test
    is_hidden: true
    scorings_per_window: 3
    closes_at: 2030-01-01T00:00:00Z
"""
    file = described(tmp_path / "benchmark.yaml", text)
    planned = answered("admin", "benchmarks", "apply", file, *WHY, "--dry-run")
    assert (planned["changes"][0]["act"], planned["changes"][0]["subject"]) == ("create", "benchmark season")
    with served.platform.database.reading() as session:
        assert session.query(Benchmark).filter_by(name="season").count() == 0, "a dry run creates nothing"
    assert answered("admin", "benchmarks", "apply", file, *WHY)["changes"]
    assert answered("admin", "benchmarks", "apply", file, *WHY)["changes"] == [], "the second time changes nothing"
    described(file, text.replace("window: 3", "window: 5").replace("First", "Second"))
    shown = stone("admin", "benchmarks", "apply", file, *WHY, "--dry-run").stdout
    assert "scorings_per_window: 3 → 5" in shown
    assert "'First season' → 'Second season'" in shown
    answered("admin", "benchmarks", "apply", file, *WHY)
    described(
        file, text.replace("window: 3", "window: 5") + "  val-lidar: {part: val, is_hidden: false, mask: lidar}\n"
    )
    answered("admin", "benchmarks", "apply", file, *WHY)
    with served.platform.database.reading() as session:
        benchmark = session.query(Benchmark).filter_by(name="season").one()
        assert (benchmark.title, benchmark.is_public) == ("First season", True)
        rows = {phase.name: phase for phase in session.query(Phase).filter_by(benchmark_id=benchmark.id)}
    assert {name: row.scorings_per_window for name, row in rows.items()} == {"val": None, "test": 5, "val-lidar": None}
    assert rows["val-lidar"].mask == "lidar"
    assert answered("admin", "phases", "show", "season", "test")["closes_at"].startswith("2030-01-01T00:00:00")


def test_an_application_that_was_cut_off_is_completed(served: Served, tmp_path: Path) -> None:
    """The benchmark stands, its visibility and its second phase do not: as after a kill between two requests."""
    dataset = answered("benchmark", "list", served.world.benchmark)["benchmarks"][0]["phases"][0]["dataset"]
    first = f"name: cut\ndataset: {dataset}\nphases:\n  val: {{part: val, is_hidden: false}}\n"
    file = described(tmp_path / "b.yaml", first)
    answered("admin", "benchmarks", "apply", file, *WHY)
    described(file, first + "  test: {part: test, is_hidden: true}\nis_public: true\n")
    changes = answered("admin", "benchmarks", "apply", file, *WHY)["changes"]
    assert [(one["act"], one["subject"]) for one in changes] == [("change", "benchmark cut"), ("create", "phase test")]
    assert answered("admin", "benchmarks", "apply", file, *WHY)["changes"] == []


def test_reported_rows_are_replaced_with_consent(served: Served, tmp_path: Path) -> None:
    at = (served.world.benchmark, "val")
    row = "- {method: M, modality: C+L, source: A paper, note: Other data, percent_digits: 1, miou: 0.2}"
    file = described(
        tmp_path / "reported.yaml", row.replace("}", ", iou_occ: null, iou_t: null, iou_p: null, iou_n: null}")
    )
    assert stone("admin", "phases", "report", *at, file, *WHY).exit_code == 2
    assert answered("admin", "phases", "reported", *at)["reported"] == []
    assert [one["miou"] for one in answered("admin", "phases", "report", *at, file, *WHY, "--yes")["reported"]] == [0.2]
    assert "M" in stone("admin", "phases", "reported", *at).stdout
    described(file, "a: 1")
    assert stone("admin", "phases", "report", *at, file, *WHY, "--yes").exit_code == 2


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("", "mapping"),
        ("[" * 2000, "YAML"),
        ("name: [a", "YAML"),
        ("name: a\n", "`name` and `dataset`"),
        ("name: a\ndataset: b\nowner: c\n", "'owner'"),
        ("name: a\ndataset: b\nphases: [val]\n", "`phases`"),
        ("name: a\ndataset: b\nphases: {val: {part: val}}\n", "is_hidden"),
        ("name: a\ndataset: b\nphases: {val: {part: val, is_hidden: false, colour: red}}\n", "'colour'"),
        ("name: &a b\ndataset: *a\n", "YAML"),
        ("name: !!python/object:os.system x\ndataset: b\n", "YAML"),
        ("name: a\x00\ndataset: b\n", "YAML"),
        ("name: a\ndataset: b\ntitle: !!binary aGk=\n", "YAML"),
        ("name: a\ndataset: b\nphases: {val: {part: !!set {a}, is_hidden: false}}\n", "YAML"),
        ("name: a\ndataset: b\nphases: {val: {part: .nan, is_hidden: false}}\n", "YAML"),
        (f"name: a\ndataset: b\nphases: {{val: {{part: 0x{'f' * 9000}, is_hidden: false}}}}\n", "YAML"),
        ("name: a\ndataset: b\nphases: {1: {part: val, is_hidden: false}}\n", "YAML"),
        ("? [a, b]\n: c\n", "YAML"),
        ("a: 1\n" * 60_000, "YAML"),
    ],
)
def test_a_file_that_describes_no_benchmark_is_refused_before_a_request(tmp_path: Path, text: str, word: str) -> None:
    file = described(tmp_path / "benchmark.yaml", text)
    result = stone("admin", "benchmarks", "apply", file, *WHY, "--server", "http://127.0.0.1:9")
    assert refused(result) == ("bad_benchmark_file" if word != "YAML" else "bad_yaml")
    assert word in result.stderr


def test_a_rescore_is_started_read_and_put_in_force_with_consent(
    served: Served, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    at = (served.world.benchmark, "val")
    with scoring(served.platform):
        monkeypatch.setenv("STONE_TOKEN", served.captain.secret)
        sent = zipped(served, tmp_path / "sub.zip")
        own = answered(
            "benchmark", "submit", sent, *served.at("val"), "--team", served.team, "--method", "A", "--modality", "L"
        )
        monkeypatch.setenv("STONE_TOKEN", served.world.administrator.secret)
        assert answered("admin", "submissions", "hide", own["id"], *WHY)["hidden_reason"] == "a test"
        assert answered("admin", "submissions", "show", own["id"], *WHY)["hidden_at"] is None
        made = answered("admin", "rescores", "start", *at, "--metric", "stone-iou-occupied-2", *WHY)
        assert made["state"] == "complete"
        built = answered("admin", "truths", "build", *at, *WHY)["ground_truth"]
    assert (built["state"], built["is_active"]) == ("ready", False)
    assert [one["number"] for one in answered("admin", "truths", "list", *at)["ground truths"]] == [2, 1]
    assert made["id"] in stone("admin", "rescores", "list", *at).stdout
    assert stone("admin", "rescores", "diff", *at, "latest").stdout.startswith("# From")
    assert stone("admin", "rescores", "activate", *at, made["id"], *WHY).exit_code == 2
    assert answered("admin", "rescores", "activate", *at, "latest", *WHY, "--dry-run")["diff"]
    with served.platform.database.reading() as session:
        assert session.get_one(Rescore, made["id"]).activated_ns is None
    assert answered("admin", "rescores", "activate", *at, made["id"], *WHY, "--yes")["rescore_id"] == made["id"]
    assert refused(stone("admin", "rescores", "activate", *at, "0" * 32, *WHY, "--yes")) == "no_rescore"
    assert answered("admin", "phases", "alarms", *at)["alarms"] == []


def test_a_backup_is_taken_listed_verified_and_restored(platform: Platform, tmp_path: Path) -> None:
    platform.settings.root.mkdir(parents=True, exist_ok=True)
    folder, data = tmp_path / "backups", ("--data", platform.settings.root)
    taken = answered("admin", "backup", "to", folder, *data)
    assert taken["is_well"]
    assert stone("admin", "backup", "to", folder, *data).exit_code == 0
    names = [one["name"] for one in answered("admin", "backup", "list", folder)["snapshots"]]
    assert (len(names), names[0]) == (2, taken["snapshot"])
    assert answered("admin", "backup", "verify", folder)["damaged"] == []
    assert stone("admin", "backup", "prune", folder, "--keep", "1").exit_code == 2
    assert answered("admin", "backup", "prune", folder, "--keep", "1", "--yes")["snapshots"] == 1
    assert refused(stone("admin", "backup", "restore", folder, *data)) == "target_not_empty"
    assert answered("admin", "backup", "restore", folder, "--data", tmp_path / "new")["is_well"]
    content = max(folder.rglob("*"), key=lambda path: path.stat().st_size if path.is_file() else -1)
    content.write_bytes(b"damage")
    damaged = stone("admin", "backup", "verify", folder)
    assert (damaged.exit_code, "DAMAGED" in damaged.stderr) == (1, True)


READING = ("list", "phases show", "jobs show", "audit", "workers", "diff", "alarms", "reported")
ACTING = [
    words for words, _ in leaves((ADMIN,)) if not words.endswith(READING) and not words.startswith("admin backup")
]


@pytest.mark.parametrize("words", ACTING)
def test_every_act_needs_a_reason(words: str) -> None:
    result = stone(*words.split(), "--server", "http://127.0.0.1:9")
    assert result.exit_code == 2


def test_a_participant_is_refused(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STONE_TOKEN", served.captain.secret)
    for words in (["users", "list"], ["jobs", "list"], ["audit"], ["workers"], ["queues", "list"]):
        result = stone("admin", *words)
        assert refused(result) == "forbidden"
        assert "stone auth login http" in result.stderr


def test_ids_are_whole_in_narrow_pipes(served: Served) -> None:
    shown = stone("admin", "users", "list").stdout
    assert served.captain.user_id in shown
