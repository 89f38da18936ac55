"""Notifications over REST: chosen, set, shown without secrets; a delivery that was given up is a dead letter."""

import httpx

from services.domain.notifications.email_addresses import new_secret
from services.runtime.jobs.control import retry
from services.runtime.orm import EmailAddress, Job, NotificationDelivery
from services.runtime.platform import Platform
from testing.api.serving import Person, client_of
from tests.services.maintenance.notifications.steps import deliveries, happened, telling, turn

AT = "/api/v1/notifications"
CHOICES = {"email": ["run.failed", "quota.low"], "webhook": ["phase.opened"]}


def test_choices_replace_those_before_and_only_known_events_are_taken(api: httpx.Client, participant: Person) -> None:
    api.headers.update(participant.headers)
    fresh = api.get(AT).json()
    assert (fresh["email"], fresh["webhook"], fresh["sends_email"], fresh["webhook_target"]) == ([], [], False, None)
    assert api.put(f"{AT}/choices", json=CHOICES).status_code == 200
    assert {name: api.get(AT).json()[name] for name in CHOICES} == CHOICES
    assert api.put(f"{AT}/choices", json={"webhook": ["run.won"]}).status_code == 422
    assert api.put(f"{AT}/choices", json={}).json()["email"] == []


def test_a_webhook_tells_its_secret_when_it_is_set_and_never_again(api: httpx.Client, participant: Person) -> None:
    api.headers.update(participant.headers)
    issued = api.put(f"{AT}/webhook", json={"url": "https://chat.example.org/hooks/x"})
    assert issued.headers["cache-control"] == "no-store"
    renewed = api.post(f"{AT}/webhook/secret").json()["secret"]
    assert renewed.startswith("whsec_")
    assert renewed != issued.json()["secret"]
    shown = api.get(AT).text
    assert "whsec_" not in shown
    assert "https://chat.example.org/hooks/x" in shown
    refused = api.put(f"{AT}/webhook", json={"url": "https://169.254.169.254/latest/meta-data"})
    assert (refused.status_code, refused.json()["code"]) == (422, "bad_webhook_url")
    assert api.delete(f"{AT}/webhook").status_code == 204
    assert (api.post(f"{AT}/webhook/secret").status_code, api.get(AT).json()["webhook_target"]) == (404, None)


def test_an_address_is_verified_by_the_secret_of_its_link(platform: Platform, participant: Person) -> None:
    told = telling(platform, smtp_host="127.0.0.1", sender="stone@example.org")
    with client_of(told, participant) as api:
        assert api.put(f"{AT}/email", json={"address": "ada@example.org"}).json()["is_verified"] is False
        assert api.put(f"{AT}/email", json={"address": "no address"}).json()["code"] == "bad_email_address"
        with told.database.transaction() as session:
            secret = new_secret(session, session.get_one(EmailAddress, participant.user_id))
        wrong = api.post(f"{AT}/email/verification", json={"secret": "x" * 43})
        assert (wrong.status_code, wrong.json()["code"]) == (409, "email_not_verified")
        assert api.post(f"{AT}/email/verification", json={"secret": secret}).json()["is_verified"] is True
        assert api.delete(f"{AT}/email").status_code == 204


def test_a_delivery_given_up_is_a_dead_letter_that_an_administrator_tries_again(
    platform: Platform, administrator: Person, participant: Person
) -> None:
    told = telling(platform, retry_s=1e-6)
    with client_of(told, participant) as api:
        api.put(f"{AT}/choices", json={"webhook": ["quota.low"]})
        api.put(f"{AT}/webhook", json={"url": "http://127.0.0.1:1/nobody-listens"})
        happened(told, participant.user_id)
        while not deliveries(told) or deliveries(told)[0].state != "dead":
            turn(told)
        (shown,) = api.get(f"{AT}/deliveries").json()["items"]
        assert (shown["kind"], shown["state"], shown["tries"]) == ("quota.low", "dead", 10)
        assert "Connection refused" in shown["answer"]
        api.headers.update(administrator.headers)
        dead = api.get("/api/v1/admin/jobs", params={"dead": True}).json()["items"]
        assert [(job["kind"], job["failure"]["code"]) for job in dead] == [("notify.deliver", "delivery_failed")]
        assert dead == api.get("/api/v1/admin/jobs", params={"queue": "notify", "state": "failed"}).json()["items"]
        reason = {"reason": "its server is back"}
        assert api.post(f"/api/v1/admin/jobs/{dead[0]['id']}/retry", json=reason).status_code == 202
        turn(told)
        assert deliveries(told)[0].tries == 11


def test_the_retry_of_a_delivery_that_is_forgotten_says_so(platform: Platform, participant: Person) -> None:
    told = telling(platform, retry_s=1e-6)
    with client_of(told, participant) as api:
        api.put(f"{AT}/choices", json={"webhook": ["quota.low"]})
        api.put(f"{AT}/webhook", json={"url": "http://127.0.0.1:1/"})
    happened(told, participant.user_id)
    while not deliveries(told) or deliveries(told)[0].state != "dead":
        turn(told)
    with told.database.transaction() as session:
        row = session.query(NotificationDelivery).one()
        job_id = row.job_id or ""
        session.delete(row)
        session.flush()
        retry(session, job_id, 3)
    turn(told)
    with told.database.reading() as session:
        assert session.get_one(Job, job_id).failure_code == "unknown_delivery"
