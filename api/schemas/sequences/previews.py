"""Previews over the wire."""

from api.schemas.base import SHA256_EXAMPLE, Answer, example

PREVIEW_EXAMPLE = {"name": "cameras.jpg", "media_type": "image/jpeg", "size_bytes": 182044, "sha256": SHA256_EXAMPLE}


class PreviewItem(Answer):
    """A picture or page to look at; its bytes are at `previews/{name}`."""

    model_config = example(**PREVIEW_EXAMPLE)

    name: str
    media_type: str
    size_bytes: int
    sha256: str
