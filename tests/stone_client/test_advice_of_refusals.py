"""What a refusal advises can be done: the options that it names are those of the command, and take what it gives."""

import re
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from stone_client.main import app
from stone_local.time_offsets import chosen_offsets
from stone_recordings.sync.errors import NoPosedFramesError
from tests.stone_recordings.writing import Recorded, write_mcap

STARTS_S = (18.0, -37.2, 999.9, 7200.0, 0.1, -1.7e9)


@pytest.mark.parametrize("apart_s", STARTS_S)
def test_where_no_sweep_has_a_pose_each_option_named_is_one_of_stone_label(apart_s: float) -> None:
    sentence = str(NoPosedFramesError("8 pose_gap", (apart_s, apart_s + 1), (0.0, 1.0)))
    command = typer.main.get_command(app)
    label = command.get_command(typer.Context(command), "label")  # type: ignore[attr-defined]
    known = {name for parameter in label.params for name in parameter.opts}
    named = re.findall(r"--[a-z-]+", sentence)
    assert "--odometry" in named
    assert set(named) <= known
    tried = re.findall(r"--time-offset (\S+)", sentence)
    assert len(tried) == (0.5 <= abs(apart_s) <= 1000)
    for choice in tried:
        assert chosen_offsets([choice]) == {"pose": round(apart_s * 1e9)}


def test_a_bad_checksum_names_the_command_that_keeps_the_rest(tmp_path: Path) -> None:
    path = write_mcap(
        tmp_path / "run.mcap", [Recorded("/a", "std_msgs/msg/String", 1, b"\x00\x01\x00\x00" + b"." * 99)]
    )
    content = bytearray(path.read_bytes())
    content[-20] ^= 1  # of the footer, which the summary's checksum covers
    path.write_bytes(content)
    refused = CliRunner().invoke(app, ["inspect", str(path)])
    assert refused.exit_code == 1
    assert "BAG-016" in refused.stderr
    assert "stone recover" in refused.stderr
    recovered = CliRunner().invoke(app, ["recover", str(path), "-o", str(tmp_path / "whole.mcap")])
    assert recovered.exit_code == 0
    assert "1 messages" in recovered.stderr
