"""Which clients this server understands, and the one that fits it."""

from fastapi import APIRouter, Request

from api.client_wheel import OLDEST_CLIENT, ClientWheel
from api.schemas.client import ClientOffer, ClientWheelItem
from services.runtime.code_version import RELEASE

router = APIRouter(tags=["client"])


@router.get("/client", summary="Show the supported client releases and the wheel")
def show_client(request: Request) -> ClientOffer:
    wheel: ClientWheel | None = request.app.state.client_wheel
    return ClientOffer(release=RELEASE, oldest_client=OLDEST_CLIENT, wheel=_item(wheel) if wheel else None)


def _item(wheel: ClientWheel) -> ClientWheelItem:
    return ClientWheelItem(filename=wheel.filename, path=wheel.path, size_bytes=len(wheel.content), sha256=wheel.sha256)
