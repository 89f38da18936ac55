"""The workspace of a run: what one machine pushes another one pulls, whole, and no more than it asked for."""

from pathlib import Path
from threading import Barrier

import pytest

from services.runtime.settings import Settings, StoreSettings
from services.runtime.store import workspace as workspaces
from services.runtime.store.factory import open_store
from services.runtime.store.keys import ObjectMissingError
from services.runtime.store.workspace import Workspace
from testing.refusals import refused_as
from testing.servers.fixtures import make_settings

RUN = "0123456789abcdef0123456789abcdef"


@pytest.fixture(params=["folder", "s3"])
def machines(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Settings, Settings]:
    """Two machines on one store; with a folder store they share the folder."""
    if request.param == "folder":
        return make_settings(tmp_path), make_settings(tmp_path)
    apart: tuple[Settings, Settings] = request.getfixturevalue("apart")
    return apart


@pytest.fixture
def apart(tmp_path: Path, s3_settings: StoreSettings) -> tuple[Settings, Settings]:
    """Two machines that share a bucket only."""
    return make_settings(tmp_path / "one", store=s3_settings), make_settings(tmp_path / "other", store=s3_settings)


def workspace_on(settings: Settings) -> Workspace:
    return Workspace(open_store(settings), settings, RUN)


@pytest.fixture
def here(machines: tuple[Settings, Settings]) -> Workspace:
    return workspace_on(machines[0])


@pytest.fixture
def there(machines: tuple[Settings, Settings]) -> Workspace:
    return workspace_on(machines[1])


def fill(workspace: Workspace, **contents: bytes) -> None:
    for name, content in contents.items():
        path = workspace.folder / name.replace("__", "/")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


def contents_of(workspace: Workspace) -> dict[str, bytes]:
    files = (path for path in workspace.folder.rglob("*") if path.is_file())
    return {path.relative_to(workspace.folder).as_posix(): path.read_bytes() for path in files}


@pytest.mark.parametrize("root_id", ["", "../other", "/absolute", "A"])
def test_a_run_outside_the_store_is_refused(machines: tuple[Settings, Settings], root_id: str) -> None:
    with refused_as("bad_key"):
        Workspace(open_store(machines[0]), machines[0], root_id)


@pytest.mark.parametrize("prefix", ["../", "tiles/../..", ".hidden"])
def test_a_prefix_outside_the_workspace_is_refused(here: Workspace, prefix: str) -> None:
    fill(here, a=b"1")
    with refused_as("bad_key"):
        here.pull(prefix)
    with refused_as("bad_key"):
        here.push(prefix)


def test_a_name_that_no_object_can_have_is_refused_on_every_store(here: Workspace) -> None:
    fill(here, Upper=b"1")
    with refused_as("bad_key", match="Upper"):
        here.push("")


def test_what_one_machine_pushed_another_one_pulls(here: Workspace, there: Workspace) -> None:
    fill(here, report=b"1", tiles__0=b"22", tiles__deep__1=b"", empty=b"")
    here.push("")
    there.pull("")
    assert contents_of(there) == {"report": b"1", "tiles/0": b"22", "tiles/deep/1": b"", "empty": b""}


def test_only_what_is_below_the_prefixes_moves(apart: tuple[Settings, Settings]) -> None:
    here, there = map(workspace_on, apart)
    fill(here, tiles__0=b"0", tiles__1=b"1", frames__0=b"f", report=b"r")
    here.push("tiles/", "rep")
    there.pull("tiles/1")
    assert contents_of(there) == {"tiles/1": b"1"}
    there.pull("")
    assert contents_of(there) == {"tiles/0": b"0", "tiles/1": b"1", "report": b"r"}


def test_what_is_here_and_stored_moves_once(apart: tuple[Settings, Settings]) -> None:
    here, store = workspace_on(apart[0]), open_store(apart[0])
    fill(here, a=b"1", b=b"2")
    here.push("")
    before = {found.key: found for found in store.listed("")}
    (here.folder / "b").unlink()
    inode = (here.folder / "a").stat().st_ino
    fill(here, c=b"3")
    here.push("")
    here.pull("")
    after = {found.key: found for found in store.listed("")}
    assert {key: after[key] for key in before} == before
    assert (here.folder / "a").stat().st_ino == inode
    assert contents_of(here) == {"a": b"1", "b": b"2", "c": b"3"}


def test_a_half_file_of_a_killed_attempt_is_replaced_by_what_is_stored(apart: tuple[Settings, Settings]) -> None:
    here, there = map(workspace_on, apart)
    fill(there, a=b"half")
    fill(here, a=b"full")
    here.push("a")
    there.pull("a")
    assert contents_of(there) == {"a": b"full"}


def test_a_file_written_again_is_pushed_again(here: Workspace, there: Workspace) -> None:
    fill(here, a=b"old")
    here.push("")
    there.pull("")
    fill(here, a=b"new")
    here.push("")
    there.pull("")
    assert contents_of(there) == {"a": b"new"}


def test_hidden_files_are_nobody_s(here: Workspace, there: Workspace) -> None:
    fill(here, a=b"1")
    (here.folder / ".a.partial").write_bytes(b"half")
    here.push("")
    (here.folder / ".a.partial").unlink()
    there.pull("")
    assert contents_of(there) == {"a": b"1"}


def test_what_is_spent_is_gone_here_and_in_the_store(here: Workspace, there: Workspace) -> None:
    fill(here, tiles__a=b"1", tiles__b=b"2", other=b"3")
    here.push("")
    here.delete("tiles/", lambda name: name == "tiles/a")
    assert set(contents_of(here)) == {"tiles/b", "other"}
    there.pull("")
    assert set(contents_of(there)) == {"tiles/b", "other"}


def test_a_removed_workspace_is_gone_here_and_in_the_store(
    machines: tuple[Settings, Settings], here: Workspace
) -> None:
    store = open_store(machines[0])
    neighbour = Workspace(store, machines[0], f"{RUN}0")
    for workspace in (here, neighbour):
        fill(workspace, a=b"1", tiles__0=b"2")
        (workspace.folder / ".partial").write_bytes(b"half")
        workspace.push("")
    folder = here.folder
    here.remove()
    here.remove()
    assert not folder.exists()
    assert {found.key for found in store.listed("")} == {f"work/{RUN}0/a", f"work/{RUN}0/tiles/0"}
    with pytest.raises(ObjectMissingError):
        store.read(f"work/{RUN}/a")


def test_what_is_pushed_in_place_is_flushed_several_at_once_and_its_folders_last(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here, flushed, together = workspace_on(make_settings(tmp_path)), list[Path](), Barrier(2)
    fill(here, parts__one=b"1", parts__two=b"2", other=b"3")

    def flush(path: Path) -> None:
        if path.is_file():
            together.wait(timeout=20)
        flushed.append(path.relative_to(here.folder))

    monkeypatch.setattr(workspaces, "flush", flush)
    here.push("parts/")
    assert set(flushed[:2]) == {Path("parts/one"), Path("parts/two")}
    assert set(flushed[2:]) == {Path(), Path("parts")}
