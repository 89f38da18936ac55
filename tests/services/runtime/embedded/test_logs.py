"""Logs of children are bounded, and their last words can be quoted."""

from pathlib import Path

from services.runtime.embedded.logs import KEPT, cut_if_large, last_words


def test_a_large_log_is_cut_while_its_writer_goes_on(tmp_path: Path) -> None:
    log = tmp_path / "api.log"
    with log.open("ab", buffering=0) as writer:
        for number in range(KEPT + 3):
            writer.write(b"%d " % number + b"x" * 100)
            assert cut_if_large(log, max_bytes=100)
        writer.write(b"after")
    assert log.read_bytes() == b"after"
    kept = sorted(path.name for path in tmp_path.iterdir())
    assert kept == ["api.log", *(f"api.log.{number}" for number in range(1, KEPT + 1))]
    assert (tmp_path / "api.log.1").read_bytes().startswith(b"%d " % (KEPT + 2))


def test_a_small_or_absent_log_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "api.log").write_text("short")
    assert not cut_if_large(tmp_path / "api.log")
    assert not cut_if_large(tmp_path / "absent.log")


def test_the_last_words_are_the_last_line_that_says_something(tmp_path: Path) -> None:
    (tmp_path / "api.log").write_bytes(b"first\n" + b"y" * 5000 + b"\nKeyError: \xff'home'\n\n  \n")
    assert last_words(tmp_path / "api.log") == "KeyError: �'home'"
    assert last_words(tmp_path / "absent.log") == ""
