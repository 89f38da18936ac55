"""Progress goes to stderr: bars on a terminal, a line for each finished stage elsewhere."""

import pytest

from stone_client.progress import reported


def test_without_a_terminal_each_finished_stage_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with reported() as progress:
        for done in range(4):
            progress("fuse", done, 3)
        progress("[red]frames", 1, 1)
    captured = capsys.readouterr()
    assert captured.err == "fuse 3/3\n[red]frames 1/1\n"
    assert captured.out == ""


def test_on_a_terminal_there_are_bars(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    with reported() as progress:
        progress("fuse", 1, 3)
        progress("frames", 0, 1)
        progress("fuse", 3, 3)
    captured = capsys.readouterr()
    assert "fuse" in captured.err
    assert "3/3" in captured.err
    assert captured.out == ""
