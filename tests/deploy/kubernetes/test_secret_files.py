"""Secrets as the kubelet lays them out: links into a hidden folder that is exchanged as a whole when they change."""

from pathlib import Path

import pytest

from services.runtime.settings import Settings


def laid_out(folder: Path, version: str, **secrets: str) -> None:
    """Write `secrets` as a new version of the volume at `folder`, and let the links mean it."""
    hidden = folder / f"..{version}"
    hidden.mkdir(parents=True)
    for name, text in secrets.items():
        (hidden / name).write_text(text)
        if not (folder / name).is_symlink():
            (folder / name).symlink_to(f"..data/{name}")
    fresh = folder / "..data_tmp"
    fresh.symlink_to(hidden.name)
    fresh.replace(folder / "..data")


def test_a_secret_of_a_cluster_is_read_and_a_changed_one_by_the_next_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STONE_SECRETS_DIR", str(tmp_path))
    monkeypatch.setenv("STONE_BROKER__URL", "redis://stone-redis:6379/0")
    laid_out(tmp_path, "2026_1", stone_database__password="old\n", stone_broker__password="p@ss/word")
    read = Settings()
    assert read.database.password.get_secret_value() == "old"
    assert read.broker.address == "redis://:p%40ss%2Fword@stone-redis:6379/0"
    laid_out(tmp_path, "2026_2", stone_database__password="new", stone_broker__password="other")
    assert Settings().database.password.get_secret_value() == "new"
    assert Settings().broker.password.get_secret_value() == "other"
