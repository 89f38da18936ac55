"""How fast a prediction is: frames a second and against real time, on stderr, a line now and then or a bar."""

import pytest

from stone_local.models.prediction_pace import PredictionPace, prediction_shown


def test_it_keeps_up_where_frames_are_predicted_as_fast_as_they_were_recorded() -> None:
    pace = PredictionPace(done=50, total=100, seconds=5.0, recorded_hz=10.0)
    assert (pace.frames_per_s, pace.real_time_ratio) == (10.0, 1.0)
    assert str(pace) == "10.00 frames/s, 1.00 × real time"


def test_of_a_single_frame_nobody_knows_how_fast_it_was_recorded() -> None:
    assert str(PredictionPace(1, 1, 2.0, None)) == "0.50 frames/s"
    assert PredictionPace(0, 1, 0.0, None).frames_per_s == 0.0


def test_without_a_terminal_the_first_and_the_last_frame_are_lines(capsys: pytest.CaptureFixture[str]) -> None:
    with prediction_shown() as paces:
        for done in range(1, 4):
            paces(PredictionPace(done, 3, 0.5 * done, 10.0))
    assert capsys.readouterr().err.splitlines() == [
        "predict 1/3 2.00 frames/s, 0.20 × real time",
        "predict 3/3 2.00 frames/s, 0.20 × real time",
    ]


def test_on_a_terminal_there_is_a_bar(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "120")
    with prediction_shown() as paces:
        paces(PredictionPace(2, 3, 1.0, 10.0))
    said = capsys.readouterr().err
    assert "2/3" in said
    assert "real time" in said
