"""Statistics: sums of rows, of those the caller may see, as JSON and as a figure of the same record."""

import io
import subprocess
import sys

import httpx
import numpy as np
import pytest
from PIL import Image

from services.domain.datasets.composition_figure import composition_png, figure_title
from services.domain.datasets.statistics import statistics_record
from services.runtime.orm import LabelSet
from services.runtime.platform import Platform
from stone.labels.class_colours import CLASS_RGB
from stone.splits.composition import CatalogueEntry
from testing.api.serving import Person, person
from testing.worlds.published import dataset, published_sequence
from tests.stone.catalogues import catalogue, entry

URL = "/api/v1/statistics"


@pytest.fixture
def driven(platform_on: Platform) -> tuple[Person, list[str]]:
    """A curator with a lake by day, a lake by night and a farm of which nothing was counted."""
    owner = person(platform_on, "curator")
    lakes = [
        published_sequence(platform_on, owner.user_id, environment="lake", illumination=i) for i in ("dusk", "night")
    ]
    farm = published_sequence(platform_on, owner.user_id, environment="farmland", region="Seoul")
    with platform_on.database.transaction() as session:
        row = session.query(LabelSet).where(LabelSet.sequence_id == farm).one()
        row.distance_m = row.t_voxels = row.p_voxels = row.n_voxels = None
    return owner, [*lakes, farm]


def test_the_sums_are_those_of_the_rows(api_on: httpx.Client, driven: tuple[Person, list[str]]) -> None:
    shown = api_on.get(URL, headers=driven[0].headers).json()
    assert shown["dataset"] is None
    assert shown["total"] == {
        "sequences": 3,
        "frames": 9,
        "duration_s": 75.0,
        "distance_m": 61.0,
        "distances_known": 2,
        "voxels": {"traversable": 200, "potentially_traversable": 400, "non_traversable": 1400},
        "class_ratios": {"traversable": 0.1, "potentially_traversable": 0.2, "non_traversable": 0.7},
        "voxels_known": 2,
    }
    assert [(one["key"], one["sequences"]) for one in shown["environments"]] == [("farmland", 1), ("lake", 2)]
    assert [(one["key"], one["sequences"]) for one in shown["halves"]] == [("day", 1), ("night", 1), ("", 1)]
    assert [(one["key"], one["sequences"]) for one in shown["regions"]] == [("Seoul", 1), ("", 2)]
    assert [(one["environment"], one["illumination"]) for one in shown["cells"]] == [
        ("farmland", ""), ("lake", "dusk"), ("lake", "night")
    ]  # fmt: skip
    farm = shown["environments"][0]
    assert (farm["voxels"], farm["class_ratios"], farm["distance_m"]) == (None, None, None)


def test_everybody_sees_the_sums_of_what_they_may_see(
    api_on: httpx.Client, platform_on: Platform, driven: tuple[Person, list[str]]
) -> None:
    def seen(role: str) -> int:
        total: dict[str, int] = api_on.get(URL, headers=person(platform_on, role).headers).json()["total"]
        return total["sequences"]

    assert (seen("participant"), seen("curator"), seen("administrator")) == (0, 0, 3)


def test_of_a_version_everybody_sees_all_but_the_voxels_of_test(
    api_on: httpx.Client, platform_on: Platform, driven: tuple[Person, list[str]]
) -> None:
    owner, (day, night, _farm) = driven
    name = dataset(platform_on, owner.user_id, {"train": [day], "test": [night]})
    headers = person(platform_on, "participant").headers
    shown = api_on.get(URL, params={"dataset": name}, headers=headers).json()
    train, test = shown["parts"]
    assert (train["key"], train["voxels_known"], train["voxels"]["traversable"]) == ("train", 1, 100)
    assert (test["key"], test["frames"], test["duration_s"], test["distance_m"]) == ("test", 3, 25.0, 30.5)
    assert (test["voxels"], test["class_ratios"], test["voxels_known"]) == (None, None, 0)
    assert shown["total"]["voxels_known"] == 1
    assert [half["voxels"] for half in shown["halves"] if half["key"] == "night"] == [None]


@pytest.mark.parametrize("path", ["", "/composition.png"])
def test_a_version_that_was_never_published_is_not_found(api: httpx.Client, participant: Person, path: str) -> None:
    answer = api.get(URL + path, params={"dataset": "nothing"}, headers=participant.headers)
    assert (answer.status_code, answer.json()["code"]) == (404, "not_found")


def test_the_figure_is_a_png_that_changes_with_what_it_shows(api: httpx.Client, platform: Platform) -> None:
    owner = person(platform, "curator")
    empty = api.get(f"{URL}/composition.png", headers=owner.headers)
    assert empty.headers["content-type"] == "image/png"
    published_sequence(platform, owner.user_id, environment="lake", illumination="night")
    filled = api.get(f"{URL}/composition.png", headers=owner.headers)
    assert filled.headers["etag"] != empty.headers["etag"]
    assert Image.open(io.BytesIO(filled.content)).size == (1320, 888)
    again = api.get(f"{URL}/composition.png", headers={**owner.headers, "If-None-Match": filled.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")


def share_of(png: bytes, colour: tuple[int, int, int], box: tuple[int, int, int, int]) -> float:
    """Of the pixels in the box (left, top, right, bottom), those of this colour."""
    pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB").crop(box))
    return float((pixels == np.array(colour)).all(axis=-1).mean())


def figure_of(entries: tuple[CatalogueEntry, ...]) -> bytes:
    record = statistics_record({"train": entries})
    return composition_png(record, figure_title(record["total"], "A dataset"))


def test_the_figure_shows_classes_by_their_share() -> None:
    """In panel b (top right) the bars of each class cover what it has of the occupied voxels."""
    png = figure_of((entry(1, voxels=(500, 250, 250)), entry(2, voxels=(500, 250, 250))))
    panel = (760, 60, 1300, 365)
    t, p, n = (share_of(png, rgb, panel) for rgb in CLASS_RGB.values())
    assert t / (t + p + n) == pytest.approx(0.5, abs=0.03)
    assert p / (t + p + n) == pytest.approx(0.25, abs=0.03)


def test_equal_records_give_equal_figures_and_no_word_is_a_formula() -> None:
    entries = (*catalogue(9, 1), entry(90, environment="$\\frac{1}{0}$", illumination="$x", region="_$^"))
    assert figure_of(entries) == figure_of(entries)


def test_an_empty_dataset_has_a_figure() -> None:
    assert figure_of(()).startswith(b"\x89PNG")


def test_the_api_loads_neither_solver_nor_plots_before_they_are_asked_for() -> None:
    program = "import sys, api.main; print([n for n in ('scipy', 'matplotlib', 'numba', 'open3d') if n in sys.modules])"
    said = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True, timeout=300)
    assert said.stdout == "[]\n"
