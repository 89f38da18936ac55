"""Which page is shown to whom: a table of pages by role, and that nobody meets a page they may not see.

**Conventions.** Columns: visitor, participant, curator (owner of nothing), administrator. A page of a thing that is
somebody else's belongs into the tests of that page.
"""

import httpx
import pytest

from services.runtime.access import sessions
from services.runtime.orm import User
from services.runtime.platform import Platform
from testing.api.serving import Person, person, serving
from web.main import make_site

ROLES = ("visitor", "participant", "curator", "administrator")
PAGES = """
/                     200 200 200 200
/sign-in              200 200 200 200
/downloads/           200 200 200 200
/codes                200 200 200 200
/codes/LAB-603        200 200 200 200
/codes/none           401 404 404 404
/docs/                200 200 200 200
/help                 200 200 200 200
/benchmarks           200 200 200 200
/benchmarks/none      401 404 404 404
/benchmarks/none/val  401 404 404 404
/benchmarks/none/val/compare             401 404 404 404
/benchmarks/none/val/metrics/stone-iou-2 401 404 404 404
/entries/00000000000000000000000000000000 401 404 404 404
/sequences            200 200 200 200
/sequences/new        401 403 200 200
/imports              401 403 200 200
/imports/00000000000000000000000000000000 401 403 404 404
/calibrations         401 200 200 200
/calibrations/00000000000000000000000000000000 401 404 404 404
/account              401 200 200 200
/device               401 200 200 200
/device?code=BCDF-GHJK 401 200 200 200
/dataset              401 200 200 200
/dataset/splits       401 403 200 200
/dataset/new          401 403 403 200
/admin/users          401 403 403 200
/admin/audit          401 403 403 200
/submissions          401 200 200 200
/teams                401 200 200 200
/submissions/00000000000000000000000000000000 401 404 404 404
/teams/00000000000000000000000000000000       401 404 404 404
/benchmarks/none/val/data                     401 404 404 404
/benchmarks/none/val/rules                    401 404 404 404
/benchmarks/none/val/submit                   401 404 404 404
/admin/jobs           401 403 403 200
/admin/jobs?list=dead 401 403 403 200
/admin/queues         401 403 403 200
/admin/benchmarks     401 403 403 200
"""


def rows() -> list[tuple[str, tuple[int, ...]]]:
    return [(path, tuple(map(int, statuses))) for path, *statuses in map(str.split, PAGES.strip().splitlines())]


def cookie(platform: Platform, who: Person) -> dict[str, str]:
    with platform.database.transaction() as session:
        opened = sessions.open_session(session, session.get_one(User, who.user_id), 3600.0)
    return {"Cookie": f"stone_session={opened.secret}"}


def test_each_page_is_shown_to_those_it_is_for(platform: Platform) -> None:
    shown = {"visitor": dict[str, str]()} | {role: cookie(platform, person(platform, role)) for role in ROLES[1:]}
    with serving(platform, make_site(platform)) as url, httpx.Client(base_url=url, timeout=300.0) as client:
        for path, statuses in rows():
            for role, status in zip(ROLES, statuses, strict=True):
                answer = client.get(path, headers={"Accept": "text/html", **shown[role]})
                assert answer.status_code == status, f"{role} at {path}: {answer.text[:300]}"
                assert answer.headers["content-type"].startswith("text/html")
                assert "default-src 'none'" in answer.headers["content-security-policy"]


@pytest.mark.parametrize(("path", "statuses"), rows())
def test_a_row_of_the_table_has_a_status_for_each_role(path: str, statuses: tuple[int, ...]) -> None:
    assert path.startswith("/")
    assert len(statuses) == len(ROLES)
