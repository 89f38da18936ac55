"""The page's idea of what is one bag is the platform's: both are asked of the same names."""

import json
from typing import Any

import pytest
from playwright.sync_api import Page

from stone_files.bag_files import BadBagFilesError, check_bag_files, is_bag_part
from testing.api.serving import Person
from testing.web.browsing import Site

NAMES = (
    "run.mcap", "RUN.MCAP", "run.db3", "run_0.db3.zstd", "run.db3-wal", "run.db3-journal", "other.db3-wal", ".mcap",
    "metadata.yaml", "Metadata.yaml", "my_msgs.Reading.msg", "my_msgs.reading.msg", "notes.txt", "run.bag", "mcap",
    "run.bag.active", "run_0.bag.zstd", "run.bag-wal", "run.active",
)  # fmt: skip
LISTS = (
    ["run_0.mcap", "run_1.mcap"], ["run.mcap", "metadata.yaml"], ["run.mcap", "RUN.mcap"], ["run.db3", "run.mcap"],
    ["metadata.yaml", "my_msgs.Reading.msg"], ["run.db3", "run.db3-wal"], ["run.db3", "other.db3-wal"],
    ["a.mcap", "b.mcap.zstd"], [f"run_{number}.db3" for number in range(512)],
    [f"run_{number}.db3" for number in range(513)], ["run_0.bag", "run_1.bag.active"], ["run_0.bag", "run_1.mcap"],
)  # fmt: skip
GROUPED: tuple[tuple[list[str], dict[str, int]], ...] = (
    (["run.mcap"], {"run.mcap": 1}),
    (["a.mcap", "b.mcap"], {"a.mcap": 1, "b.mcap": 1}),
    (["run_0.mcap", "run_1.mcap"], {"run": 2}),
    (["day/a.mcap", "day/b.db3"], {"a.mcap": 1, "b.db3": 1}),
    (["day/run/run_0.db3", "day/run/metadata.yaml", "day/x.mcap"], {"run": 2, "x.mcap": 1}),
    (["day/run/a.mcap", "day/run/b.mcap", "day/run/metadata.yaml"], {"run": 3}),
    (["day/metadata.yaml", "notes.txt"], {}),
    (["run.db3", "run.db3-wal"], {"run.db3": 2}),
    (["day/run_0.bag", "day/run_1.bag.active"], {"day": 2}),
    (["radar.bag", "run.mcap"], {"radar.bag": 1, "run.mcap": 1}),
)


def ask(page: Page, body: str, given: object) -> Any:
    """What the page's own module says."""
    built = page.evaluate(
        "document.querySelector('script[src*=\"upload/mount.js\"]').src.replace('mount.js', 'bags.js')"
    )
    return page.evaluate(f"async ([at, given]) => {{ const bags = await import(at); {body} }}", [built, given])


def is_refused(names: list[str]) -> bool:
    try:
        check_bag_files(names)
    except BadBagFilesError:
        return True
    return False


@pytest.fixture
def page(site: Site, curator: Person) -> Any:
    with site.visit(curator) as page:
        page.goto("/sequences/new")
        yield page


def test_the_page_and_the_platform_agree_on_what_a_bag_is(page: Page) -> None:
    parts = ask(page, "return given.map(bags.isBagPart)", NAMES)
    assert dict(zip(NAMES, parts, strict=True)) == {name: is_bag_part(name) for name in NAMES}
    troubles = ask(page, "return given.map(names => bags.troubleOf(names) !== '')", LISTS)
    assert troubles == [is_refused(list(names)) for names in LISTS]
    body = """return given.map(paths => Object.fromEntries(bags.sorted(paths.map(path =>
      ({path, file: new File(['x'], path.split('/').at(-1))}))).bags.map(bag => [bag.name, bag.files.length])))"""
    for (paths, expected), found in zip(GROUPED, ask(page, body, [paths for paths, _ in GROUPED]), strict=True):
        assert found == expected, json.dumps(paths)
