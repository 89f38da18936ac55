"""Lists and boards are compressed for who takes it, under a tag of their own; whatever holds a secret is not."""

import gzip

import httpx
import pytest
from starlette.requests import Request

from api.compression import LEAST_BYTES, tagged_response, takes_gzip
from testing.api.serving import Person
from testing.worlds.made import sequence

URL = "/api/v1/sequences"


def asked(**headers: str) -> Request:
    named = [(name.replace("_", "-").encode(), value.encode()) for name, value in headers.items()]
    return Request({"type": "http", "method": "GET", "path": "/", "headers": named})


TAKING = ("gzip", "br, gzip;q=0.5", "GZIP", "gzip;q=1.0")
NOT_TAKING = ("", "br", "gzip;q=0", "gzip; q=0.000", "x-gzip")


@pytest.mark.parametrize("said", [*TAKING, *NOT_TAKING])
def test_a_client_takes_what_it_says(said: str) -> None:
    assert takes_gzip(asked(accept_encoding=said)) == (said in TAKING)


@pytest.mark.parametrize("size", [LEAST_BYTES - 1, LEAST_BYTES])
def test_only_what_is_worth_it_is_compressed(size: int) -> None:
    content = b"a" * size
    answer = tagged_response(asked(accept_encoding="gzip"), content, "text/plain")
    is_zipped = answer.headers.get("content-encoding") == "gzip"
    assert is_zipped == (size >= LEAST_BYTES)
    assert (gzip.decompress(answer.body) if is_zipped else answer.body) == content


def test_either_tag_stands_for_what_one_has() -> None:
    content = b"a" * LEAST_BYTES
    tags = {tagged_response(asked(accept_encoding=said), content, "a/b").headers["etag"] for said in ("gzip", "br")}
    assert len(tags) == 2
    for tag in tags:
        for said in ("gzip", "br"):
            answer = tagged_response(asked(if_none_match=tag, accept_encoding=said), content, "a/b")
            assert (answer.status_code, answer.body) == (304, b"")
    assert tagged_response(asked(if_none_match=tags.pop()), b"other" * LEAST_BYTES, "a/b").status_code == 200


def test_a_list_is_the_same_list_compressed_and_who_one_is_is_not_compressed(
    api: httpx.Client, curator: Person
) -> None:
    for number in range(5):
        sequence(api, curator, f"forest-{number}")
    plain = api.get(URL, headers=curator.headers | {"Accept-Encoding": "identity"})
    zipped = api.get(URL, headers=curator.headers | {"Accept-Encoding": "gzip"})
    assert (plain.headers.get("content-encoding"), zipped.headers["content-encoding"]) == (None, "gzip")
    assert plain.content == zipped.content
    assert int(zipped.headers["content-length"]) < int(plain.headers["content-length"]) / 2
    assert "Accept-Encoding" in zipped.headers["vary"]
    assert "content-encoding" not in api.get("/api/v1/me", headers=curator.headers).headers
