"""The scrub detects decayed objects at the configured rate, and continues where it stopped."""

import os
from dataclasses import replace
from pathlib import Path

import pytest

from services.maintenance import scrub as scrub_module
from services.maintenance.scrub import AGAIN_S, TURN_BYTES, Scrub
from services.runtime.orm import Blob
from services.runtime.platform import Platform
from services.runtime.settings import StoreSettings
from services.runtime.store.blobs import keep
from services.runtime.store.faults import note_served, noted_faults, scrub_status
from services.runtime.store.folder import FolderStore
from stone.errors import PlatformFaultError
from testing.servers.fixtures import having
from tests.services.maintenance.test_store_repair import blobs, laid

__all__ = ["blobs"]
UNBOUND = {"scrub_bytes_per_s": 10**12}


class Clock:
    """A clock that a test advances."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


def faults(platform: Platform) -> dict[str, str]:
    with platform.database.reading() as session:
        return {one.sha256: one.fault for one in noted_faults(session)}


def passed_ns(platform: Platform) -> int | None:
    with platform.database.reading() as session:
        return scrub_status(session).passed_ns


def test_what_is_gone_cut_or_changed_is_found_and_forgotten_when_it_is_back(
    platform: Platform, blobs: dict[str, Blob], tmp_path: Path
) -> None:
    clock = Clock()
    scrub = Scrub(having(platform, store=UNBOUND), clock)
    scrub.turn()
    assert faults(platform) == {
        blobs["gone"].sha256: "missing",
        blobs["cut"].sha256: "size",
        blobs["changed"].sha256: "bytes",
    }
    assert passed_ns(platform) is not None
    for name in ("gone", "cut", "changed"):
        platform.store.write(blobs[name].object_key, tmp_path / "brought" / name)
    clock.now_s += AGAIN_S
    scrub.turn()
    assert faults(platform) == {}


def test_what_a_reader_met_is_looked_at_before_the_rest_is_paid_for(platform: Platform, blobs: dict[str, Blob]) -> None:
    scrub = Scrub(having(platform, store={"scrub_bytes_per_s": 1}), Clock())
    scrub.turn()
    note_served(platform.database, [blobs["kept"].object_key, blobs["changed"].object_key])
    scrub.turn()
    assert faults(platform)[blobs["changed"].sha256] == "bytes"
    assert blobs["kept"].sha256 not in faults(platform), "a sound object is taken for a damaged one"


def test_a_disk_that_cannot_read_a_sector_is_a_fault_and_the_pass_goes_on(
    platform: Platform, blobs: dict[str, Blob], monkeypatch: pytest.MonkeyPatch
) -> None:
    read = FolderStore.read

    def failing(store: FolderStore, key: str, *span: int) -> object:
        if key == blobs["kept"].object_key:
            raise OSError(5, "Input/output error")
        return read(store, key, *span)

    monkeypatch.setattr(FolderStore, "read", failing)
    Scrub(having(platform, store=UNBOUND), Clock()).turn()
    assert faults(platform)[blobs["kept"].sha256] == "bytes"
    assert passed_ns(platform) is not None


def test_a_store_that_is_away_harms_nothing_and_skips_nothing(
    platform: Platform, blobs: dict[str, Blob], monkeypatch: pytest.MonkeyPatch
) -> None:
    scrub = Scrub(having(platform, store=UNBOUND), Clock())
    with monkeypatch.context() as away:
        away.setattr(FolderStore, "size_bytes", lambda *_: _raise(PlatformFaultError("store_unavailable", "gone")))
        with pytest.raises(PlatformFaultError):
            scrub.turn()
    assert faults(platform) == {}
    scrub.turn()
    assert len(faults(platform)) == 3


def _raise(error: Exception) -> object:
    raise error


@pytest.fixture
def many(platform: Platform, tmp_path: Path) -> dict[str, Blob]:
    folder = tmp_path / "brought"
    folder.mkdir()
    return laid(platform, folder)


def read_keys(platform: Platform, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return a list that collects the keys of later reads."""
    keys: list[str] = []
    read = FolderStore.read

    def noting(store: FolderStore, key: str, *span: int) -> object:
        keys.append(key)
        return read(store, key, *span)

    monkeypatch.setattr(FolderStore, "read", noting)
    return keys


def test_a_pass_goes_on_in_another_process_where_it_was(
    platform: Platform, many: dict[str, Blob], monkeypatch: pytest.MonkeyPatch
) -> None:
    keys = read_keys(platform, monkeypatch)
    for _ in many:
        Scrub(having(platform, store={"scrub_bytes_per_s": 1}), Clock()).turn()  # one object each
    assert keys == [many[name].object_key for name in sorted(many, key=lambda name: many[name].sha256)]
    assert passed_ns(platform) is not None


def test_two_that_scrub_count_an_object_once(platform: Platform, many: dict[str, Blob]) -> None:
    slow = having(platform, store={"scrub_bytes_per_s": 32 * 2**10})
    one, other = (Clock(), Clock())
    scrubs = [(Scrub(slow, one), one), (Scrub(slow, other), other)]
    for _ in range(2):
        for scrub, clock in scrubs:
            scrub.turn()
            clock.now_s += 1.0
    with platform.database.reading() as session:
        status = scrub_status(session)
    assert status.objects <= len(many)
    assert status.objects or status.passed_ns


def test_the_mean_is_what_the_setting_says_and_a_large_object_is_read_in_turns(
    platform: Platform, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "large"
    path.write_bytes(os.urandom(2 * TURN_BYTES + 5))
    with platform.database.transaction() as session:
        blob = keep(session, platform.store, path)
    monkeypatch.setattr(scrub_module, "AGAIN_S", 1.0)
    clock, rate = Clock(), 2**20
    scrub = Scrub(having(platform, store={"scrub_bytes_per_s": rate}), clock)
    keys = read_keys(platform, monkeypatch)
    scrub.turn()
    assert passed_ns(platform) is None, "all of it is read in one turn"
    begun_s, passes = clock.now_s, 0
    while passes < 3:
        before = passed_ns(platform)
        clock.now_s += 1.0
        scrub.turn()
        passes += passed_ns(platform) != before
    assert keys == [blob.object_key] * 3
    assert clock.now_s - begun_s >= 2 * blob.size_bytes / rate - 1.0


@pytest.mark.parametrize(("store", "is_read"), [({}, True), ({"scrub_bytes_per_s": 0}, False)])
def test_nothing_is_read_where_it_is_switched_off(
    platform: Platform, many: dict[str, Blob], monkeypatch: pytest.MonkeyPatch, store: dict[str, int], is_read: bool
) -> None:
    keys = read_keys(platform, monkeypatch)
    Scrub(having(platform, store=store), Clock()).turn()
    assert bool(keys) == is_read


@pytest.mark.parametrize("scrubs_bucket", [False, True])
def test_a_bucket_is_read_only_if_its_operator_says_so(
    platform: Platform, many: dict[str, Blob], monkeypatch: pytest.MonkeyPatch, scrubs_bucket: bool
) -> None:
    keys = read_keys(platform, monkeypatch)
    settings = platform.settings.model_copy(
        update={"store": StoreSettings(s3_bucket="elsewhere", scrubs_bucket=scrubs_bucket)}
    )
    Scrub(replace(platform, settings=settings), Clock()).turn()
    assert bool(keys) == scrubs_bucket
