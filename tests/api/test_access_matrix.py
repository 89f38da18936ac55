"""Every route, as every caller, with the things of a curator: what may be done is done, nothing else is, or is told."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import httpx
import pytest
from fastapi import FastAPI

from api.deps import SAFE
from api.main import make_api
from services.runtime.database.migrate import upgrade
from services.runtime.platform import Platform
from services.runtime.settings import ApiSettings, BrokerSettings
from testing.api.serving import serving
from testing.servers.fixtures import make_settings, opened
from tests.api.access.cast import CALLERS, OF_OWNER, Cast, make_cast
from tests.api.access.ledger import ledger_of
from tests.api.access.matrix import Answer, Matrix, make_matrix, neutral, operations_in, unlisted
from tests.api.access.table import TABLE, Operation, expectations
from tests.api.access.world import UNKNOWN, World, make_world

NO_BROKER = BrokerSettings("redis://127.0.0.1:1/0")
UNBOUND = ApiSettings(requests_per_minute=10**7, sign_ins_per_minute=10**7)
OF_PLATFORM = {("splits", "dataset")}  # nobody's own; administrators put them
SUCCEEDING = ("owner", "administrator", "browser")
ENDING_WHAT_ASKS = {("DELETE", "/api/v1/tokens/current")}  # each caller's own token, which the next cell would miss


@dataclass(frozen=True)
class Scene:
    """A served application, with a cast and a world that only refused callers and readers meet."""

    platform: Platform
    application: FastAPI
    matrix: Matrix
    cast: Cast
    world: World

    def fresh(self) -> tuple[Cast, World]:
        """People and things that may be changed; published versions, which nothing changes, are the scene's."""
        cast = make_cast(self.platform)
        return cast, make_world(self.platform, cast.users["owner"], self.world.named["dataset_name"])


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Scene]:
    settings = make_settings(tmp_path_factory.mktemp("scene"), api=UNBOUND, broker=NO_BROKER)
    upgrade(settings)
    platform = opened(settings, [])
    application, cast = make_api(platform), make_cast(platform)
    world = make_world(platform, cast.users["owner"])
    with serving(platform, application) as url, httpx.Client(base_url=url, timeout=300.0) as client:
        yield Scene(platform, application, make_matrix(client, application, expectations(TABLE)), cast, world)
    platform.database.close()


def owner_of(scene: Scene) -> tuple[str, str]:
    return ("users", scene.cast.user_id("owner"))


def test_no_route_is_forgotten(platform: Platform) -> None:
    assert unlisted(make_api(platform), expectations(TABLE)) == set()


def takes_away(operation: Operation) -> int:
    """Return a later turn for operations that delete, so that one world serves more cells."""
    return (operation[0] == "DELETE" and "{" in operation[1]) + 2 * (operation in ENDING_WHAT_ASKS)


def in_its_tier(caller: str) -> Any:
    """Whoever may change things does so in worlds of their own: the owner alone every day."""
    is_dear = caller in SUCCEEDING and caller != "owner"
    return pytest.param(caller, id=caller, marks=pytest.mark.whole if is_dear else ())


@pytest.mark.whole
@pytest.mark.parametrize("caller", [in_its_tier(caller) for caller in CALLERS])
def test_every_cell_is_as_the_table_says(
    scene: Scene, caller: str, record_property: Callable[[str, object], None]
) -> None:
    """Catches alone a route that somebody may use who should not, or may not who should.

    Who may change the owner's things does so in a world of their own, and in a fresh one if that is used up.
    """
    found: list[str] = []
    cells = 0
    before = ledger_of(scene.platform)
    own: tuple[Cast, World] | None = None
    for operation in sorted(operations_in(scene.matrix.document), key=takes_away):
        is_changing = operation[0] not in SAFE and scene.matrix.table[operation][caller] < 400
        if is_changing and (caller in SUCCEEDING or operation in ENDING_WHAT_ASKS):
            own = own or scene.fresh()
            if list(scene.matrix.findings(caller, *own, operation)):  # what was changed before may be in its way
                own = scene.fresh()
                found += scene.matrix.findings(caller, *own, operation)
        else:
            found += scene.matrix.findings(caller, scene.cast, scene.world, operation)
        cells += 1
    assert "\n".join(found) == ""
    assert cells == len(expectations(TABLE))
    record_property("cells", cells)
    after = ledger_of(scene.platform)
    theirs = {("users", scene.cast.user_id(caller))} | (OF_PLATFORM if caller == "administrator" else set())
    assert set(before.lost_or_changed(after)) <= theirs - {owner_of(scene)}
    if caller not in (*OF_OWNER, "administrator"):
        assert before.added_about(after, scene.world.ids) == []


def test_what_is_ones_own_is_in_ones_lists(scene: Scene) -> None:
    """Without this, an empty list would pass for one that hides what it should."""
    cast, world = scene.fresh()
    for path in (
        "sequences",
        "calibrations",
        "uploads",
        "jobs",
        "tokens",
        "teams",
        "submissions",
        "admin/jobs",
        "admin/users",
    ):
        caller = "administrator" if path in ("admin/jobs", "admin/users") else "owner"
        answer = scene.matrix.client.get(f"/api/v1/{path}?limit=200", headers=cast.headers[caller])
        assert any(one in answer.text for one in world.ids), path


BODIES = {
    "a calibration": ("PUT", "/api/v1/sequences/{sequence_id}/calibration", "calibration_id"),
    "an upload": ("POST", "/api/v1/sequences/{sequence_id}/recordings", "complete_upload"),
    "an upload to import": ("POST", "/api/v1/dataset-imports", "complete_upload"),
}


@pytest.mark.whole
@pytest.mark.parametrize(("method", "path", "named"), BODIES.values(), ids=BODIES)
@pytest.mark.parametrize("caller", ["other", "modest"])
def test_an_id_of_somebody_else_in_a_body_opens_nothing(
    scene: Scene, method: str, path: str, named: str, caller: str
) -> None:
    """One's own sequence, and the calibration or upload of somebody else: as if there were none."""
    mine = make_world(scene.platform, scene.cast.users[caller], scene.world.named["dataset_name"]).named
    before = ledger_of(scene.platform)
    answers = []
    for foreign in (scene.world.named[named], UNKNOWN[named]):
        key = named.replace("complete_upload", "upload_id")
        response = scene.matrix.client.request(
            method, path.format_map(mine), json={key: foreign}, headers=scene.cast.headers[caller]
        )
        answers.append(neutral(Answer(response.status_code, response.text, dict(response.headers)), {foreign}))
    assert answers[0] == answers[1]
    assert answers[0][0] == 404
    assert before == ledger_of(scene.platform)


BELOW = ("recordings/{recording_id}", "recordings/{recording_id}/previews/bev.png", "recordings/{recording_id}/roles",
         "exports/{export_id}", "exports/{export_id}/archive", "exports/{export_id}/files",
         "exports/{export_id}/files/{path}", "label-comparisons/{comparison_id}",
         "label-comparisons/{comparison_id}/frames/{token}.png")  # fmt: skip


@pytest.mark.parametrize("caller", ["owner", "other"])
def test_what_is_below_one_sequence_is_not_found_below_another_of_ones_own(scene: Scene, caller: str) -> None:
    mine = make_world(scene.platform, scene.cast.users[caller], scene.world.named["dataset_name"]).named["sequence_id"]
    for path in BELOW:
        below = f"/api/v1/sequences/{mine}/{path.format_map(scene.world.named)}"
        answer = scene.matrix.client.get(below, headers=scene.cast.headers[caller])
        assert (answer.status_code, answer.json()["code"]) == (404, "not_found"), path
    recording = BELOW[0].format_map(scene.world.named)
    gone = scene.matrix.client.delete(f"/api/v1/sequences/{mine}/{recording}", headers=scene.cast.headers[caller])
    assert gone.status_code == 404
