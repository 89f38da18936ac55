"""Tables at any width of the terminal: ids, dates and numbers are whole, whatever else is wrapped."""

import re

import pytest
from rich.table import Table

from stone_client import tables
from stone_client.server.label_sets import label_set_table
from stone_client.server.scores import submissions_table
from stone_client.tables import plain_table, show

ID = "01a223216a010000e2ad31397e2abcde"
SUBMISSION = {
    "id": ID, "method": "A long name of a method with many words in it", "modality": "C+L+R", "kind": "validation",
    "state": "scored", "withdrawn_at": "2026-11-28T12:03:04Z", "problems_total": 12_345_678,
    "finalized_at": "2026-11-28T12:03:04Z", "created_at": "2026-11-28T12:00:00Z",
}  # fmt: skip
LABEL_SET = {
    "id": ID, "profile": "field", "frames": 1_234_567, "held_out_recall": 0.99, "gravest": {"code": "LAB-603"},
    "created_at": "2026-11-28T12:03:04Z", "code_version": "0.1.0+7dff9d00cc4d", "is_counting": True,
}  # fmt: skip
TITLED = plain_table(f"A {ID}  B {ID}, %", "", "A")
TITLED.add_row("mIoU", "12.3")


@pytest.mark.parametrize("columns", [20, 40, 80, 120])
@pytest.mark.parametrize(
    ("table", "whole"),
    [
        (submissions_table([SUBMISSION] * 2), (ID, "2026-11-28T12:03", "12,345,678", "scored,", "validation")),
        (label_set_table("a sequence with a long name", [LABEL_SET]), (ID, "2026-11-28T12:03:04", "1,234,567", "99.0")),
        (TITLED, (ID, "12.3")),
    ],
    ids=["submissions", "label sets", "title"],
)
def test_no_width_cuts_or_wraps_an_id_a_date_or_a_number(
    table: Table,
    whole: tuple[str, ...],
    columns: int,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(tables, "PIPE_COLUMNS", columns)
    show(table)
    printed = capsys.readouterr().out
    for word in whole:
        assert word in printed
    assert "…" not in printed


def test_long_words_that_are_no_ids_are_wrapped_and_stay_complete(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(tables, "PIPE_COLUMNS", 30)
    table = plain_table("t", "topic", "n")
    table.add_row("/a_very_long_topic_name_that_fits_no_column", "")
    show(table)
    rows = capsys.readouterr().out.splitlines()[3:]
    assert re.sub(r"\s", "", "".join(rows)).replace("─", "") == "/a_very_long_topic_name_that_fits_no_column"
