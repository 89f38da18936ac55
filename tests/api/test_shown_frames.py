"""Pictures of frames and zips of predictions: whose they are, what they show, and of which frames there is none.

**Conventions.** A world with real labels and zips: an open phase over val, a hidden one over test. The entry is of team
0 in `val`; pictures are held against what is made of the grids that were sent and laid down.
"""

import io
import shutil
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from sqlalchemy import select

from services.domain.viewer.frame_picture import difference_picture, picture_bytes
from services.runtime.orm import Benchmark, Dataset, DatasetMember, Phase, SubmissionRow, Team, TeamMember
from testing.api.serving import Person, client_of
from testing.servers.fixtures import Bells, make_settings, opened
from testing.worlds import published
from testing.worlds.benchmark_world import Grid, World, labels_npz, run_eval
from testing.worlds.sending import guess, send, standing_world, zipped
from tests.api.boarding import refused

URL = "/api/v1"


@dataclass(frozen=True)
class Sent:
    """The world, whose benchmark is public, and what was sent into it: ids and bytes by name."""

    api: httpx.Client
    world: World
    ids: dict[str, str]
    zips: dict[str, bytes]

    @property
    def people(self) -> dict[str, Person | None]:
        at = self.world
        return {"visitor": None, "team": at.captains[0], "other": at.captains[1], "administrator": at.administrator}

    def ask(self, path: str, who: str = "visitor") -> httpx.Response:
        person = self.people[who]
        return self.api.get(f"{URL}{path}", headers=person.headers if person else {})

    def truth_of(self, token: str, part: str = "val", who: str = "visitor") -> httpx.Response:
        return self.ask(f"/benchmarks/{self.world.benchmark}/phases/{part}/frames/{token}.png", who)

    def frame_of(self, name: str, token: str, show: str = "prediction", who: str = "visitor") -> httpx.Response:
        return self.ask(f"/submissions/{self.ids[name]}/frames/{token}.png?show={show}", who)

    def zip_of(self, name: str, who: str) -> httpx.Response:
        return self.ask(f"/submissions/{self.ids[name]}/predictions.zip", who)

    def change(self, kind: type[Any], row_id: str, **columns: Any) -> None:
        with self.world.platform.database.transaction() as session:
            row = session.get_one(kind, row_id)
            for name, value in columns.items():
                setattr(row, name, value)


@dataclass(frozen=True)
class Scored:
    """What was sent into a world whose platform is closed: nobody changes what is in its folder."""

    world: World
    ids: dict[str, str]
    zips: dict[str, bytes]


@pytest.fixture(scope="module")
def scored(tmp_path_factory: pytest.TempPathFactory, _sqlite_template: Path) -> Scored:
    with standing_world(tmp_path_factory.mktemp("scored"), _sqlite_template) as world:
        files: dict[str, tuple[str, bytes, dict[str, Any]]] = {
            "entry": ("val", zipped(world, guess(world)), {}),
            "foreign": ("val", foreign_zip(guess(world, turn=2)), {"team": 1}),
            "baseline": ("val", zipped(world, guess(world, turn=3)), {"kind": "baseline", "team": 1}),
            "hidden": ("test", zipped(world, guess(world, "test")), {}),
            "hidden baseline": ("test", zipped(world, guess(world, "test", 2)), {"kind": "baseline", "team": 1}),
        }
        ids = {name: send(world, content, part, **said) for name, (part, content, said) in files.items()}
        run_eval(world.platform)
        with world.platform.database.transaction() as session:
            assert set(session.scalars(select(SubmissionRow.state))) == {"scored"}
            session.scalars(select(Benchmark)).one().is_public = True
    return Scored(world, ids, {name: content for name, (_, content, _) in files.items()})


@pytest.fixture
def sent(scored: Scored, tmp_path: Path, bells: Bells) -> Iterator[Sent]:
    """The same on a copy of that platform."""
    settings = make_settings(tmp_path)
    shutil.copytree(scored.world.platform.settings.root, settings.root, symlinks=True)
    platform = opened(settings, bells)
    with client_of(platform) as api:
        yield Sent(api, replace(scored.world, platform=platform), scored.ids, scored.zips)
    platform.database.close()


def absent(reply: httpx.Response) -> bool:
    """Answered as what does not exist, for which a visitor is asked to sign in."""
    is_visitor = "authorization" not in reply.request.headers
    return refused(reply) == ((401, "unauthenticated") if is_visitor else (404, "not_found"))


def foreign_zip(frames: dict[str, Grid]) -> bytes:
    """As another script packs them: in a folder, the array unnamed."""
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w") as archive:
        for token, grid in frames.items():
            content = io.BytesIO()
            np.savez_compressed(content, grid)
            archive.writestr(f"run/{token}.npz", content.getvalue())
    return whole.getvalue()


def observed() -> Grid:
    with np.load(io.BytesIO(labels_npz(np.zeros((256, 256, 32), np.uint8)))) as arrays:
        return np.asarray(arrays["mask_lidar"])


def test_a_visitor_sees_the_truth_the_prediction_and_where_they_differ(sent: Sent) -> None:
    for name, turn in (("entry", 0), ("foreign", 2)):
        for token, truth in sent.world.truth("val").items():
            predicted = guess(sent.world, turn=turn)[token]
            assert sent.truth_of(token).content == picture_bytes(truth, observed())
            assert sent.frame_of(name, token).content == picture_bytes(predicted, observed())
            assert sent.frame_of(name, token, "truth").content == picture_bytes(truth, observed())
            shown = sent.frame_of(name, token, "difference").content
            assert shown == difference_picture(truth, predicted) != difference_picture(predicted, truth)


@pytest.mark.whole
@pytest.mark.parametrize("standing", ["running", "ended"])
def test_nobody_is_shown_a_frame_of_a_hidden_phase(sent: Sent, standing: str) -> None:
    if standing == "ended":
        sent.change(Phase, sent.world.test, opens_ns=1, closes_ns=2)
    for who in sent.people:
        for part in ("test", "val"):
            for token in sent.world.truth(part):
                for name in ("hidden", "hidden baseline"):
                    for show in ("prediction", "truth", "difference"):
                        assert refused(sent.frame_of(name, token, show, who)) == (403, "frames_hidden")
                assert absent(sent.truth_of(token, "test", who))
        for token in sent.world.truth("test"):
            assert absent(sent.truth_of(token, "val", who))
            assert absent(sent.frame_of("entry", token, "prediction", who))


def test_a_phase_that_hides_val_shows_no_frame_of_it(sent: Sent) -> None:
    sent.change(Phase, sent.world.val, is_hidden=True)
    token = next(iter(sent.world.truth("val")))
    for who in sent.people:
        assert absent(sent.truth_of(token, "val", who))
        assert refused(sent.frame_of("entry", token, "prediction", who)) == (403, "frames_hidden")


def test_a_frame_that_another_version_hides_is_not_shown_of_an_open_phase(sent: Sent) -> None:
    """The other version has one sequence of val in test; the other sequence stays shown."""
    world = sent.world
    hidden, shown = world.grids["val"]
    with world.platform.database.reading() as session:
        dataset = session.scalars(select(Dataset).where(Dataset.name == world.dataset)).one()
        members = session.scalars(select(DatasetMember).where(DatasetMember.dataset_id == dataset.id)).all()
        ids = {member.name: member.sequence_id for member in members}
    before = sent.truth_of(next(iter(world.grids["val"][hidden])))
    assert before.status_code == 200
    train = [ids[name] for name in world.grids["train"]]
    published.dataset(world.platform, world.administrator.user_id, {"train": train, "test": [ids[hidden]]})
    for token in world.grids["val"][hidden]:
        for who in sent.people:
            assert absent(sent.truth_of(token, who=who))
            for show in ("prediction", "truth", "difference"):
                assert absent(sent.frame_of("entry", token, show, who))
    for token in world.grids["val"][shown]:
        assert sent.truth_of(token).status_code == sent.frame_of("entry", token).status_code == 200


def test_a_benchmark_that_is_not_public_shows_a_visitor_nothing_of_it(sent: Sent) -> None:
    with sent.world.platform.database.transaction() as session:
        session.scalars(select(Benchmark)).one().is_public = False
    token = next(iter(sent.world.truth("val")))
    assert sent.truth_of(token).status_code == sent.frame_of("entry", token).status_code == 401
    assert (
        sent.truth_of(token, who="other").status_code == sent.frame_of("entry", token, who="other").status_code == 200
    )


def test_a_zip_is_its_teams_and_that_of_an_open_baseline_is_for_whoever_is_signed_in(sent: Sent) -> None:
    given = {
        "entry": {"team", "administrator"},
        "foreign": {"other", "administrator"},
        "baseline": {"team", "other", "administrator"},
        "hidden": {"team", "administrator"},
        "hidden baseline": {"other", "administrator"},
    }
    for name, may in given.items():
        for who in sent.people:
            reply = sent.zip_of(name, who)
            if who in may:
                assert reply.content == sent.zips[name]
            else:
                assert refused(reply) == ((401, "unauthenticated") if who == "visitor" else (403, "withheld")), name
    sent.change(Phase, sent.world.test, opens_ns=1, closes_ns=2)
    assert refused(sent.zip_of("hidden baseline", "team")) == (403, "withheld")


def test_a_zip_that_was_purged_is_told_to_be_gone(sent: Sent) -> None:
    sent.change(SubmissionRow, sent.ids["entry"], blob_sha256=None)
    token = next(iter(sent.world.truth("val")))
    assert refused(sent.frame_of("entry", token, who="other")) == (404, "predictions_gone")
    assert refused(sent.zip_of("entry", "team")) == (404, "predictions_gone")


def test_whoever_leaves_the_team_loses_the_zip(sent: Sent) -> None:
    assert sent.zip_of("entry", "team").status_code == 200
    with sent.world.platform.database.transaction() as session:
        mine = select(TeamMember).where(TeamMember.team_id == sent.world.teams[0])
        for row in session.scalars(mine.where(TeamMember.user_id == sent.world.captains[0].user_id)):
            session.delete(row)
        assert session.get(Team, sent.world.teams[0])
    assert refused(sent.zip_of("entry", "team")) == (403, "withheld")
