"""Label sets by age, as `stone label-sets compare --sequence` takes them, on a real server."""

import pytest

from services.eval.stages import handlers
from services.runtime.platform import Platform
from stone_client.api import Api
from stone_client.credentials import Server
from stone_client.server.label_sets import NoLabelSetError, compare_label_sets, label_sets_of
from stone_client.server.newest import place_from_newest
from testing.api.serving import person, serving
from testing.worlds.made import frame_labels, labels
from tests.working import working


@pytest.mark.parametrize(
    ("named", "place"),
    [("latest", 0), ("latest~1", 1), ("latest~0", 0), ("newest", None), ("latest~", None), ("", None)],
)
def test_a_name_by_age_is_a_place_from_the_newest(named: str, place: int | None) -> None:
    assert place_from_newest(named) == place


def test_label_sets_are_named_by_id_or_by_age_and_any_other_name_is_refused(platform: Platform) -> None:
    curator = person(platform, "curator")
    with serving(platform) as url, Api(Server(url, curator.secret)) as api:
        made = api.create("/sequences", {"name": "forest"})
        earlier = labels(platform, made, contents=[frame_labels(1)] * 2, seed=b"earlier")
        later = labels(platform, made, contents=[frame_labels(2)] * 2, seed=b"later")
        assert [one["id"] for one in label_sets_of(api, made["id"])] == [later.id, earlier.id]
        for named in ("latest~2", "yesterday's"):
            with pytest.raises(NoLabelSetError, match=r"expected is an id, or latest, .* of the 2 of this sequence"):
                compare_label_sets(api, made, ("latest", named), lambda *_: None)
        with working(platform, "eval", handlers):
            compared = compare_label_sets(api, made, ("latest", earlier.id), lambda *_: None)
        assert (compared["a_id"], compared["b_id"], compared["record"]["frames"]) == (later.id, earlier.id, 2)
