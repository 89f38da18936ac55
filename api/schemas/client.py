"""The client that fits this server, over the wire."""

from api.schemas.base import Answer, example


class ClientWheelItem(Answer):
    """The wheel as `pip install` fetches it; `path` is on this server."""

    model_config = example(
        filename="stone_client-0.2.0-py3-none-any.whl",
        path="/downloads/stone_client-0.2.0-py3-none-any.whl",
        size_bytes=121492,
    )

    filename: str
    path: str
    size_bytes: int
    sha256: str


class ClientOffer(Answer):
    """The server's release, the oldest client that it understands, and the wheel that fits; null: none was built."""

    model_config = example(release="0.2.0", oldest_client="0.1.0", wheel=None)

    release: str
    oldest_client: str
    wheel: ClientWheelItem | None
