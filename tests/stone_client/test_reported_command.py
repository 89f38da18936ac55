"""`stone benchmark reported`: a published table onto a board, by administrators, whole or not at all."""

import json
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest

from services.domain.benchmarks.phases.reported_results import ReportedRow, put_reported, reported_in
from services.runtime.orm import Phase
from stone.scoring.metric import RATIOS
from stone_client.api import Api
from stone_client.connection import connected
from stone_client.errors import ServerRefusedError
from stone_client.server.published_tables import TABLE2, TABLES
from stone_client.server.reported import Putting, put_table
from stone_local.ceiling import row_of
from testing.api.serving import person
from testing.worlds.benchmark_world import World
from tests.stone_client.participating import Served, answered, joined, refused, stone

OTHER = ReportedRow("Another", "L+R", "another paper", miou=0.2)
NOT_COMPARABLE = (
    "Published by the paper for its own recordings, of which split it does not say; not scored here, not comparable "
    "with a score on other data."
)


@pytest.fixture
def served(served_world: tuple[World, str], monkeypatch: pytest.MonkeyPatch) -> Served:
    """As the administrator, with one reported row of another paper on the board of val."""
    made = joined(*served_world)
    monkeypatch.setenv("STONE_URL", made.url)
    monkeypatch.setenv("STONE_TOKEN", made.world.administrator.secret)
    lay(made, OTHER)
    return made


def lay(served: Served, *rows: ReportedRow) -> None:
    with served.platform.database.transaction() as session:
        put_reported(session, session.get_one(Phase, served.world.val), rows)


def standing(served: Served) -> dict[tuple[str, str], tuple[str, float | None]]:
    with served.platform.database.reading() as session:
        return {(row.method, row.modality): (row.id, row.miou) for row in reported_in(session, served.world.val)}


def put(served: Served, *more: str) -> dict[str, Any]:
    return answered("benchmark", "reported", "table2", *served.at("val"), *more)


def test_who_is_no_administrator_puts_nothing(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STONE_TOKEN", served.captain.secret)
    before = standing(served)
    assert refused(stone("benchmark", "reported", "table2", *served.at("val"))) == "forbidden"
    assert standing(served) == before
    unscoped = person(served.platform, "administrator", scopes=("read", "submit"))
    monkeypatch.setenv("STONE_TOKEN", unscoped.secret)
    assert refused(stone("benchmark", "reported", "table2", *served.at("val"))) == "forbidden", (
        "a token without the scope"
    )
    monkeypatch.setenv("STONE_TOKEN", "nobody's")
    assert refused(stone("benchmark", "reported", "table2", *served.at("val"))) == "unauthenticated"


def test_the_ten_rows_stand_as_printed_beside_others_and_are_put_once(served: Served) -> None:
    first = put(served)
    assert [row["done"] for row in first["rows"]] == ["put"] * 10
    before = standing(served)
    assert len(before) == 11
    assert before["Another", "L+R"][1] == OTHER.miou
    assert [row["done"] for row in put(served)["rows"]] == ["left"] * 10
    assert standing(served) == before, "the very same rows"
    shown = stone("benchmark", "reported", "table2", *served.at("val"))
    assert shown.stdout.count("unchanged") == 10
    assert NOT_COMPARABLE in shown.stdout


def test_a_ceiling_stands_beside_the_other_rows(served: Served, tmp_path: Path) -> None:
    ratios = dict.fromkeys(RATIOS, 0.41234)
    record = {"frames": 7, "signature": "s", "total": ratios, "tolerant": ratios, "columns": {**ratios, "miou": None}}
    record["extras"] = {"n_predicted_drivable_ratio": 0.0662}
    (tmp_path / "ceiling.json").write_text(json.dumps(row_of(record, "run", "sweeps")))
    answered("benchmark", "reported", tmp_path / "ceiling.json", *served.at("val"))
    rows = standing(served)
    assert rows.keys() == {("Another", "L+R"), ("Ceiling by sweeps: run", "L")}
    assert rows["Ceiling by sweeps: run", "L"][1] == 0.412
    first, *_ = answered("benchmark", "leaderboard", served.world.benchmark, "val")["rows"]
    assert (first["standing"], first["rank"], first["method"]) == ("ceiling", None, "Ceiling by sweeps: run")
    assert "danger 6.6." in first["note"]
    assert "ceiling" in stone("benchmark", "leaderboard", served.world.benchmark, "val").stdout
    again = answered("benchmark", "reported", tmp_path / "ceiling.json", *served.at("val"))
    assert [row["done"] for row in again["rows"]] == ["left"]


def test_a_row_that_stands_otherwise_is_named_and_replaced_only_when_asked(served: Served) -> None:
    typed = ReportedRow("OccFusion", "C+L", TABLE2.source, 0.661, 0.191, 0.369, 0.628, None, NOT_COMPARABLE, 1)
    lay(served, OTHER, typed)
    before = standing(served)
    result = stone("benchmark", "reported", "table2", *served.at("val"))
    assert refused(result) == "reported_differs"
    assert (
        "OccFusion (C+L): mIoU is –, in the table 39.6, IoU T is 19.1, in the table 19.0, another note" in result.stderr
    )
    assert standing(served) == before, "nothing was written"
    done = {(row["method"], row["modality"]): row["done"] for row in put(served, "--replace")["rows"]}
    assert done.pop(("OccFusion", "C+L")) == "replaced"
    assert set(done.values()) == {"put"}
    after = standing(served)
    assert after["OccFusion", "C+L"] == (before["OccFusion", "C+L"][0], 0.396)
    assert after["Another", "L+R"] == before["Another", "L+R"]


def test_rows_that_somebody_puts_meanwhile_are_not_lost(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    sent = Api.send

    def overtaken(api: Api, method: str, path: str, **request: Any) -> Any:
        if method == "PUT":
            lay(served, OTHER, ReportedRow("Meanwhile", "C", "a third paper"))
        return sent(api, method, path, **request)

    monkeypatch.setattr(Api, "send", overtaken)
    with connected(None) as api, pytest.raises(ServerRefusedError, match="read it again"):
        put_table(api, TABLE2, Putting(served.world.benchmark, "val", "as published"))
    assert set(standing(served)) == {("Another", "L+R"), ("Meanwhile", "C")}


@pytest.mark.parametrize("name", TABLES)
def test_a_published_mean_is_that_of_its_classes(name: str) -> None:
    """What is printed is rounded, so the mean of rounded values is off by less than a tenth: a typing error is not."""
    for row in TABLES[name].rows:
        *_, t, p, n, miou = (Decimal(printed) for printed in row.percent)
        assert abs((t + p + n) / 3 - miou) <= Decimal("0.1"), row
