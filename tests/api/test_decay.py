"""No route serves decayed data as sound: every file of every route is requested twice.

**Conventions.** All files are read while they are sound, then one bit of every object of the store flips. From then on
a response has the same bytes as before, is a refusal, or ends early. All caches of the process are cleared.
"""

import functools
import gc
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import delete, select

from api.main import make_api
from api.openapi import operations
from services.maintenance.scrub import Scrub
from services.runtime.orm import Blob, CalibrationRow, StoreFault
from services.runtime.platform import Platform
from services.runtime.store.blobs import keep, prepare_all
from services.runtime.store.faults import noted_faults, scrub_status
from testing.api.serving import Person, client_of, person
from testing.servers.fixtures import having
from testing.worlds.decay import decay
from tests.api.crawling import urls_of
from tests.api.hidden_stage import known, staged

pytestmark = pytest.mark.whole

API = "/api/v1"
BROKEN = {
    f"{API}/calibrations/{{calibration_id}}/file",
    f"{API}/datasets/{{dataset_name}}/archives/{{part}}",
    f"{API}/datasets/{{dataset_name}}/manifest",
    f"{API}/frames/{{token}}/labels.npz",
    f"{API}/sequences/{{sequence_id}}/exports/{{export_id}}/archive",
    f"{API}/sequences/{{sequence_id}}/exports/{{export_id}}/files/{{path}}",
    f"{API}/sequences/{{sequence_id}}/frames.parquet",
    f"{API}/sequences/{{sequence_id}}/mesh",
    f"{API}/sequences/{{sequence_id}}/previews/{{name}}",
    f"{API}/sequences/{{sequence_id}}/report",
    f"{API}/sequences/{{sequence_id}}/scene/tiles/{{tile_name}}",
    f"{API}/sequences/{{sequence_id}}/sequence.npz",
    f"{API}/submissions/{{submission_id}}/confusions",
    f"{API}/submissions/{{submission_id}}/predictions.zip",
}
"""Routes that must refuse; otherwise the objects behind them did not decay."""


@dataclass(frozen=True, eq=False)
class Sound:
    """A platform with something of everything: the bodies of its files by address, and their routes."""

    platform: Platform
    caller: Person
    routes: Mapping[str, str]
    bodies: Mapping[str, bytes]


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory, _sqlite_template: Path) -> Iterator[Sound]:
    folder = tmp_path_factory.mktemp("decay")
    with staged(folder, _sqlite_template) as stage:
        platform = stage.world.platform
        caller = person(platform, "administrator")
        ids = known(stage.world) | {"calibration_id": [calibration(platform, caller, folder / "rig.yaml")]}
        routes = files_of(make_api(platform).openapi(), ids)
        with client_of(platform, caller) as client:
            answers = {url: client.get(url) for url in routes}
        yield Sound(platform, caller, routes, {url: one.content for url, one in answers.items() if one.is_success})


def calibration(platform: Platform, owner: Person, path: Path) -> str:
    path.write_bytes(b"a rig\n" * 99)
    with platform.database.transaction() as session:
        blob = keep(session, platform.store, path)
        facts = {"filename": "rig.yaml", "sha256": blob.sha256, "blob_sha256": blob.sha256, "version": 1}
        row = CalibrationRow(owner_id=owner.user_id, name="rig", sensors=[], findings=[], **facts)
        session.add(row)
        session.flush()
        return row.id


def files_of(document: dict[str, Any], ids: Mapping[str, list[str]]) -> dict[str, str]:
    """Return the addresses of all files, with their routes: a route that also serves ranges serves a file."""
    return {
        url: path
        for path, method, operation in operations(document)
        if method == "get" and "206" in operation["responses"]
        for url in urls_of(path, operation, ids)
    }


def object_keys(platform: Platform) -> list[str]:
    with platform.database.reading() as session:
        return list(session.scalars(select(Blob.object_key).order_by(Blob.object_key)))


def flip_all(platform: Platform, place: float) -> None:
    """Flip a bit of every object; a second call makes them sound again."""
    for key in object_keys(platform):
        decay(platform, key, place)


def forget_all() -> None:
    for one in gc.get_objects():
        if isinstance(one, functools._lru_cache_wrapper):
            one.cache_clear()


def asked_again(sound: Sound) -> tuple[list[str], Counter[str]]:
    """Return the addresses with a complete but different response, and the refused or cut responses by route."""
    wrong, refused = list[str](), Counter[str]()
    forget_all()
    with client_of(sound.platform, sound.caller) as client:
        for url, body in sound.bodies.items():
            try:
                answer = client.get(url)
            except httpx.RemoteProtocolError:
                refused[sound.routes[url]] += 1
                continue
            if answer.is_success and answer.content != body:
                wrong.append(url)
            refused[sound.routes[url]] += not answer.is_success
    forget_all()
    return wrong, refused


def passed_ns(platform: Platform) -> int | None:
    with platform.database.reading() as session:
        return scrub_status(session).passed_ns


@pytest.fixture
def _forgotten(sound: Sound) -> Iterator[None]:
    yield
    with sound.platform.database.transaction() as session:
        session.execute(delete(StoreFault))


@pytest.mark.usefixtures("_forgotten")
@pytest.mark.parametrize("place", [0.05, 0.5, 0.999])
def test_no_file_is_answered_with_other_bytes_than_were_stored(sound: Sound, place: float) -> None:
    flip_all(sound.platform, place)
    try:
        wrong, refused = asked_again(sound)
    finally:
        flip_all(sound.platform, place)
    assert wrong == []
    with sound.platform.database.reading() as session:
        assert noted_faults(session), "nobody will know"
    assert place != 0.5 or {route for route in BROKEN if not refused[route]} == set()
    wrong, refused = asked_again(sound)
    assert (wrong, +refused) == ([], Counter()), "what is sound is refused"


@pytest.mark.usefixtures("_forgotten")
def test_the_scrub_finds_every_kind_and_the_same_content_mends_it(sound: Sound, tmp_path: Path) -> None:
    platform, copies = sound.platform, list[Path]()
    for number, key in enumerate(object_keys(platform)):
        copies.append(tmp_path / f"{number}")
        copies[-1].write_bytes(b"".join(platform.store.read(key)))
    flip_all(platform, 0.5)
    scrub = Scrub(having(platform, store={"scrub_bytes_per_s": 10**12}))
    while passed_ns(platform) is None:
        scrub.turn()
    with platform.database.reading() as session:
        assert sorted(one.object_key for one in noted_faults(session, 10**6)) == object_keys(platform)
    assert len(list(prepare_all(platform.store, platform.database, copies))) == len(copies)
    with platform.database.reading() as session:
        assert noted_faults(session) == []
    assert asked_again(sound)[0] == []
