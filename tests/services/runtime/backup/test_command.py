"""The administrator's command, and rows as text: read back as they were, written as PostgreSQL writes them."""

from pathlib import Path

import psycopg
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.runtime.backup.__main__ import main
from services.runtime.backup.tables import Kind, kind_of, line_of, lines_of, row_of
from services.runtime.embedded.listen_socket import hold_folder
from services.runtime.orm import Base
from services.runtime.platform import Platform
from tests.services.runtime.backup.laid import Laid, lay


@pytest.fixture
def laid(platform: Platform, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Laid:
    monkeypatch.setenv("STONE_DATA_FOLDER", str(platform.settings.root))
    return lay(platform, tmp_path / "scratch")


def test_taken_listed_verified_restored_and_pruned(
    platform: Platform, laid: Laid, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = str(tmp_path / "backups")
    assert main(["to", folder]) == main(["to", folder]) == 0
    first, second = capsys.readouterr().out.splitlines()
    assert main(["list", folder]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == [first.split()[-1], second.split()[-1]]
    assert main(["verify", folder]) == 0
    assert main(["prune", folder, "--keep", "1"]) == 0
    monkeypatch.setenv("STONE_DATA_FOLDER", str(tmp_path / "target"))
    assert main(["restore", folder]) == 0


def test_refusals_end_with_1_and_say_their_code(
    platform: Platform, laid: Laid, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = str(tmp_path / "backups")
    assert main(["restore", folder]) == 1
    assert capsys.readouterr().err.startswith("snapshot_missing: ")
    assert main(["to", folder]) == 0
    assert main(["restore", folder]) == 1
    assert capsys.readouterr().err.startswith("target_not_empty: ")


def test_nothing_is_restored_under_a_platform_that_serves(
    platform: Platform, laid: Laid, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["to", str(tmp_path / "backups")]) == 0
    with hold_folder(platform.settings.root):
        assert main(["restore", str(tmp_path / "backups")]) == 1
    assert "already" in capsys.readouterr().err


KINDS: tuple[Kind, ...] = ("text", "integer", "float", "boolean", "json", "bytes")
TEXTS = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]))
ROWS = st.tuples(
    st.none() | TEXTS,
    st.none() | st.integers(-(2**63), 2**63 - 1),
    st.none() | st.floats(allow_nan=False),
    st.none() | st.sampled_from([0, 1]),
    st.none() | TEXTS,
    st.none() | st.binary(),
)


@given(st.lists(ROWS, max_size=5), st.integers(1, 7))
def test_rows_are_read_back_as_they_were_in_whatever_pieces_they_come(
    rows: list[tuple[object, ...]], piece_bytes: int
) -> None:
    text = "".join(line_of(row, KINDS) + "\n" for row in rows).encode()
    pieces = [text[start : start + piece_bytes] for start in range(0, len(text), piece_bytes)]
    assert [tuple(row_of(line, KINDS)) for line in lines_of(pieces)] == rows


@pytest.mark.parametrize(
    ("value", "kind", "literal"),
    [
        ("a\tb\\c\nd\re", "text", "E'a\\tb\\\\c\\nd\\re'"),
        ("\b\f\v", "text", "E'\\b\\f\\x0b'"),
        ("\\N", "text", "'\\N'"),
        ("", "text", "''"),
        (None, "text", "NULL::text"),
        (-(2**63), "integer", "(-9223372036854775807 - 1)::bigint"),
        (0.1 + 0.2, "float", "0.30000000000000004::float8"),
        (5e-324, "float", "5e-324::float8"),
        (1.0, "float", "1::float8"),
        (1, "boolean", "true"),
        (0, "boolean", "false"),
        ('{"a":  [1, "\\u00e9"]}', "json", '\'{"a":  [1, "\\u00e9"]}\'::json'),
        ("null", "json", "'null'::json"),
        (b"\x00\\\n\xff", "bytes", "'\\x005c0aff'::bytea"),
    ],
)
def test_postgresql_writes_what_we_read_and_reads_what_we_write(
    postgres_url: str, value: object, kind: Kind, literal: str
) -> None:
    with psycopg.connect(postgres_url) as connection, connection.cursor() as cursor:
        with cursor.copy(f"COPY (SELECT {literal} AS v) TO STDOUT".encode()) as copy:
            (line,) = lines_of([bytes(piece) for piece in copy])
        assert row_of(line, [kind]) == [value]
        cursor.execute(f"CREATE TEMP TABLE written AS SELECT {literal} AS v WITH NO DATA".encode())
        with cursor.copy("COPY written FROM STDIN") as copy:
            copy.write(line_of([value], [kind]) + "\n")
        cursor.execute(f"SELECT v::text IS NOT DISTINCT FROM ({literal})::text FROM written".encode())
        assert cursor.fetchone() == (True,)


def test_a_file_without_an_end_is_no_file() -> None:
    with pytest.raises(ValueError, match="incomplete"):
        list(lines_of([b"a\nb"]))


def test_every_column_of_every_table_has_a_kind() -> None:
    kinds = {kind_of(column) for table in Base.metadata.tables.values() for column in table.columns}
    assert kinds == set(KINDS)
