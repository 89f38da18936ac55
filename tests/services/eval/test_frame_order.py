"""Frames stand in time order where a table tells it; where none does, nothing is said of these places."""

import secrets
import shutil
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from services.eval.ground_truth import find_ground_truth
from services.eval.pipeline import score
from stone.scoring.metric import RATIOS
from stone_local.frame_order import TABLE, in_time_order
from stone_submissions.errors import GroundTruthError
from testing.worlds.submission_files import write_submission
from tests.services.eval.conftest import World

TOKENS = tuple(secrets.token_hex(16) for _ in range(40))
SEQUENCES = {"north": TOKENS[:25], "south": TOKENS[25:]}


def write_table(folder: Path, tokens: tuple[str, ...], first_ns: int = 0) -> None:
    """A frame and then one that was excluded, which has a stamp and no token."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = {"frame_token": [*tokens, None], "stamp_ns": range(first_ns, first_ns + len(tokens) + 1)}
    pq.write_table(pa.table({name: list(column) for name, column in rows.items()}), folder / TABLE)


def test_one_table_beside_the_frames_orders_them(tmp_path: Path) -> None:
    write_table(tmp_path, TOKENS)
    by_name = {name: sorted(tokens) for name, tokens in SEQUENCES.items()}
    assert in_time_order(tmp_path / "gts", by_name) == SEQUENCES


def test_each_sequence_may_bring_its_own_table(tmp_path: Path) -> None:
    for name, tokens in SEQUENCES.items():
        write_table(tmp_path / "gts" / name, tokens, first_ns=1_700_000_000_000_000_000)
    by_name = {name: sorted(tokens) for name, tokens in SEQUENCES.items()}
    assert in_time_order(tmp_path / "gts", by_name) == SEQUENCES


def test_a_frame_in_no_table_leaves_the_order_unknown(tmp_path: Path) -> None:
    assert in_time_order(tmp_path / "gts", SEQUENCES) is None
    write_table(tmp_path / "gts" / "north", SEQUENCES["north"])
    write_table(tmp_path / "gts" / "south", SEQUENCES["south"][1:])
    assert in_time_order(tmp_path / "gts", SEQUENCES) is None


@pytest.mark.parametrize("content", [b"", b"PAR1" + bytes(40) + b"PAR1"])
def test_a_table_that_cannot_be_read_is_named(content: bytes, tmp_path: Path) -> None:
    (tmp_path / TABLE).write_bytes(content)
    with pytest.raises(GroundTruthError, match=TABLE):
        in_time_order(tmp_path / "gts", SEQUENCES)


def test_a_table_without_stamps_is_named(tmp_path: Path) -> None:
    pq.write_table(pa.table({"frame_token": list(TOKENS)}), tmp_path / TABLE)
    with pytest.raises(GroundTruthError, match="stamp_ns"):
        in_time_order(tmp_path / "gts", SEQUENCES)


def test_without_the_order_no_interval_of_these_places_is_told(world: World, tmp_path: Path) -> None:
    write_submission(tmp_path / "sub.zip", world.predictions.items())
    record = score(tmp_path / "sub.zip", world.folder, order=in_time_order).as_record()
    assert record["intervals"]["these_places"] == dict.fromkeys(RATIOS)
    assert record["silences"]["these_places"] == dict.fromkeys(RATIOS, "unknown_order")
    assert set(record["silences"]["new_place"].values()) == {"few_sequences"}


def test_with_the_order_the_score_is_the_same_and_its_frames_stand_in_time(world: World, tmp_path: Path) -> None:
    write_submission(tmp_path / "sub.zip", world.predictions.items())
    shutil.copytree(world.folder, tmp_path / "truth")
    tokens = tuple(sorted(world.labels, reverse=True))
    write_table(tmp_path / "truth", tokens)
    ordered = find_ground_truth(tmp_path / "truth", order=in_time_order)
    for listed in ordered.manifest.sequences.values():
        assert list(listed) == [token for token in tokens if token in listed]
    submission = tmp_path / "sub.zip"
    record = score(submission, ordered.folder, order=in_time_order).as_record()
    without = score(submission, world.folder, order=in_time_order).as_record()
    assert "unknown_order" not in record["silences"]["these_places"].values()
    assert record["total"] == without["total"]
    assert record["signature"] == without["signature"]
