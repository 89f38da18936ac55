"""Other users of the machine cannot read the platform's files; an open data folder causes a warning."""

import stat
from pathlib import Path

import pytest

from services.runtime.processes.private_files import PRIVATE, open_data_folder
from stone_client.server.sequences import ensure_sequence
from testing.stone_serve import serving


@pytest.mark.parametrize(("mode", "is_warned"), [(0o700, False), (0o755, True), (0o710, True), (0o701, True)])
def test_a_folder_that_others_may_enter_is_warned_of_with_the_way_to_close_it(
    tmp_path: Path, mode: int, is_warned: bool
) -> None:
    tmp_path.chmod(mode)
    warning = open_data_folder(tmp_path)
    assert (warning is not None) == is_warned
    if warning is not None:
        assert warning.code == "data_folder_open"
        assert f"has mode {mode:04o}" in str(warning)
        assert str(warning).endswith(f"chmod -R go= '{tmp_path}'")


@pytest.mark.whole
def test_served_in_a_folder_that_stood_open_every_file_is_private_and_the_folder_is_warned_of(tmp_path: Path) -> None:
    """Catches alone a process of the platform that writes with the umask it inherited."""
    data = tmp_path / "stood"
    data.mkdir()
    data.chmod(0o755)
    with serving(data) as running, running.api() as api:
        ensure_sequence(api, "run")
        opened = [path for path in data.rglob("*") if _is_open(path)]
        assert opened == []
        assert (data / "stone.sqlite3").exists()
        assert "data_folder_open" in running.output.read_text()


def _is_open(path: Path) -> bool:
    facts = path.lstat()
    return bool(stat.S_IMODE(facts.st_mode) & PRIVATE) and not stat.S_ISLNK(facts.st_mode)
