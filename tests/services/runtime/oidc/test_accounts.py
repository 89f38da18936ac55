"""Accounts of people who sign in by a provider: one each, by issuer and subject; never another's, whatever the name."""

from typing import Any

import pytest
from sqlalchemy import func, select

from services.runtime.access import users
from services.runtime.access.erasure import erase_user
from services.runtime.oidc.accounts import AdmittedUser, admit, role_of
from services.runtime.oidc.provider import VerifiedIdentity
from services.runtime.oidc.settings import OidcSettings
from services.runtime.orm import ExternalIdentity, User
from services.runtime.platform import Platform
from testing.refusals import refused_as
from testing.threads import at_once

ISSUER = "https://id.lab.example"
GROUPS = OidcSettings(administrators="stone-admins", curators="field-team", participants="students, guests")


def who(subject: str = "s-1", issuer: str = ISSUER, **claims: Any) -> VerifiedIdentity:
    return VerifiedIdentity(issuer, subject, {"preferred_username": "ada", **claims})


def admitted(platform: Platform, identity: VerifiedIdentity, settings: OidcSettings | None = None) -> AdmittedUser:
    with platform.database.transaction() as session:
        return admit(session, identity, settings or OidcSettings())


def local(platform: Platform, name: str, role: str = "curator") -> User:
    with platform.database.transaction() as session:
        return users.create_user(session, name, role, "correct horse battery staple")


@pytest.mark.parametrize(
    ("groups", "role"),
    [
        (["stone-admins", "field-team"], "administrator"),
        (["field-team", "students"], "curator"),
        (["guests"], "participant"),
        ("students", "participant"),
        (["students", 5, None], "participant"),
    ],
)
def test_the_highest_role_of_somebodys_groups_is_theirs(groups: Any, role: str) -> None:
    assert role_of({"groups": groups}, GROUPS) == role


@pytest.mark.parametrize(
    "groups", [None, [], ["Stone-Admins"], ["stone-admins,"], {"stone-admins": 1}, 7, [["guests"]]]
)
def test_who_is_in_no_group_is_not_let_in(groups: Any) -> None:
    with refused_as("not_admitted"):
        role_of({"groups": groups}, GROUPS)


def test_where_no_group_of_participants_is_named_everybody_is_one() -> None:
    assert role_of({}, OidcSettings(curators="field-team")) == "participant"
    assert role_of({}, OidcSettings()) is None


def test_the_first_sign_in_makes_the_account_and_the_next_finds_it(platform: Platform) -> None:
    first, again = admitted(platform, who()), admitted(platform, who(preferred_username="renamed"))
    assert (first.is_new, first.user.name, first.user.role, first.user.password_hash) == (
        True,
        "ada",
        "participant",
        "",
    )
    assert (again.is_new, again.user.id, again.user.name) == (False, first.user.id, "ada")


def test_an_equal_name_is_no_proof_the_newcomer_gets_a_name_of_their_own(platform: Platform) -> None:
    owner = local(platform, "ada", "administrator")
    made = [admitted(platform, who(f"s-{number}")).user for number in range(3)]
    assert [user.name for user in made] == ["ada-2", "ada-3", "ada-4"]
    assert owner.id not in {user.id for user in made}
    assert {user.role for user in made} == {"participant"}


def test_the_same_subject_of_another_issuer_is_another_person(platform: Platform) -> None:
    first, second = admitted(platform, who()), admitted(platform, who(issuer="https://other.example"))
    assert first.user.id != second.user.id


@pytest.mark.whole
@pytest.mark.parametrize(
    ("claims", "links"),
    [
        ({"email": "ada@lab.example", "email_verified": True}, False),
        ({"email": "ada@lab.example", "email_verified": False}, True),
        ({"email": "ada@lab.example", "email_verified": "true"}, True),
        ({"email": "ada@lab.example"}, True),
        ({"email": ["ada@lab.example"], "email_verified": True}, True),
        ({"preferred_username": "ada@lab.example", "email_verified": True}, True),
    ],
)
def test_an_address_that_is_not_verified_or_not_allowed_to_link_gives_no_account(
    platform: Platform, claims: dict[str, Any], links: bool
) -> None:
    owner = local(platform, "ada@lab.example")
    assert admitted(platform, who(**claims), OidcSettings(links_verified_email=links)).user.id != owner.id


def test_a_verified_address_gives_the_account_of_that_name_once_where_it_is_allowed(platform: Platform) -> None:
    owner, links = local(platform, "ada@lab.example"), OidcSettings(links_verified_email=True)
    proof = {"email": "Ada@Lab.example", "email_verified": True}
    assert admitted(platform, who(**proof), links).user.id == owner.id
    assert admitted(platform, who(), OidcSettings()).user.id == owner.id, "linked for good"
    assert admitted(platform, who("s-2", **proof), links).user.id != owner.id, "it is somebody's already"


def test_an_administrators_account_is_never_given_by_an_address(platform: Platform) -> None:
    owner = local(platform, "root@lab.example", "administrator")
    claims = {"email": "root@lab.example", "email_verified": True}
    assert admitted(platform, who(**claims), OidcSettings(links_verified_email=True)).user.id != owner.id


def test_roles_follow_groups_at_each_sign_in(platform: Platform) -> None:
    local(platform, "admin", "administrator")
    seen = [admitted(platform, who(groups=[group]), GROUPS) for group in ("students", "stone-admins", "field-team")]
    assert [one.user.role for one in seen] == ["participant", "administrator", "curator"]
    assert [one.role_before for one in seen] == ["participant", "participant", "administrator"]
    assert len({one.user.id for one in seen}) == 1


def test_where_no_group_gives_a_role_the_platforms_own_stays(platform: Platform) -> None:
    user = admitted(platform, who()).user
    with platform.database.transaction() as session:
        users.change_user(session, session.get_one(User, user.id), "curator", None)
    assert admitted(platform, who()).user.role == "curator"


def test_the_last_administrator_is_not_made_another_by_their_groups(platform: Platform) -> None:
    admitted(platform, who(groups=["stone-admins"]), GROUPS)
    with refused_as("last_administrator"):
        admitted(platform, who(groups=["students"]), GROUPS)


def test_who_was_shut_out_stays_out(platform: Platform) -> None:
    user = admitted(platform, who()).user
    with platform.database.transaction() as session:
        users.change_user(session, session.get_one(User, user.id), None, is_active=False)
    with refused_as("account_deactivated"):
        admitted(platform, who())


def test_who_was_erased_is_known_no_more(platform: Platform) -> None:
    user = admitted(platform, who()).user
    with platform.database.transaction() as session:
        erase_user(session, session.get_one(User, user.id))
        assert session.scalar(select(func.count()).select_from(ExternalIdentity)) == 0
    assert admitted(platform, who()).user.id != user.id


@pytest.mark.parametrize(
    ("said", "name"),
    [
        ("Ada Löwe", "ada-l-we"),
        ("<b>ada</b>", "b-ada-b"),
        ("../../etc", "..-..-etc"),
        ("a" * 100, "a" * 56),
        ("ada@lab.example", "ada@lab.example"),
    ],
)
def test_a_name_is_made_of_what_may_be_one(platform: Platform, said: str, name: str) -> None:
    assert admitted(platform, who(preferred_username=said)).user.name == name


@pytest.mark.parametrize("said", [None, 7, "", "   ", "東京"])
def test_who_has_no_name_that_can_be_one_is_given_one(platform: Platform, said: Any) -> None:
    assert admitted(platform, who(preferred_username=said)).user.name.startswith("user-")


def test_first_sign_ins_at_once_are_one_account(platform_on: Platform) -> None:
    made = at_once(8, lambda _: admitted(platform_on, who()))
    assert len({one.user.id for one in made}) == 1
    assert [one.is_new for one in made].count(True) == 1
