"""OpenAPI descriptions of the tus routes: headers, streamed bodies, refusals."""

from typing import Any

from api.answers import Responses, refusals
from services.runtime.uploads.creation import PURPOSES


def _headers(**described: str) -> dict[str, Any]:
    text = {"type": "string"}
    return {name.replace("_", "-"): {"description": words, "schema": text} for name, words in described.items()}


_PROGRESS = _headers(
    Tus_Resumable="1.0.0", Upload_Offset="bytes that are here", Upload_Expires="until when it waits (RFC 9110 date)"
)

STREAM: dict[str, Any] = {
    "requestBody": {
        "required": False,
        "content": {"application/offset+octet-stream": {"schema": {"type": "string", "format": "binary"}}},
    }
}
FORM: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            "multipart/form-data": {
                "schema": {
                    "type": "object",
                    "required": ["file", "purpose"],
                    "properties": {
                        "file": {"type": "string", "format": "binary"},
                        "purpose": {"type": "string", "enum": list(PURPOSES)},
                        "target_id": {"type": "string"},
                        "sha256": {"type": "string"},
                    },
                }
            }
        },
    }
}
OPTIONS_SAY: Responses = {204: {"description": "what is spoken", "headers": _headers(Tus_Version="1.0.0")}}
CREATED: Responses = {
    201: {"description": "created", "headers": {**_headers(Location="the upload"), **_PROGRESS}},
    **refusals(400, 404, 408, 409, 412, 413, 415, 423, 460, 507),
}
HEAD_SAYS: Responses = {
    200: {"description": "where to resume", "headers": _PROGRESS},
    **refusals(404, 409, 410, 412, 460, 507),
}
PATCHED: Responses = {
    204: {"description": "appended", "headers": _PROGRESS},
    **refusals(400, 404, 408, 409, 410, 412, 413, 415, 423, 460, 507),
}
TERMINATED: Responses = {204: {"description": "terminated"}, **refusals(404, 409, 410, 412, 423)}
GOT: Responses = refusals(404)
FORMED: Responses = {
    201: {"description": "complete", "headers": _headers(Location="the upload")},
    **refusals(400, 404, 408, 409, 413, 415, 460, 507),
}
