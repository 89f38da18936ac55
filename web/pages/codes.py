"""Public pages of codes: the list, and for each code its meaning, its effect on labels and the remedy."""

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse

from api.deps import Looker
from api.errors import NotFoundError
from stone_base.codes.catalogue import CATALOGUE, PROFILE_CODES, by_family
from stone_base.codes.meaning import HARM_SENTENCES
from stone_base.codes.renamed import RENAMED
from web.rendering import page

router = APIRouter(prefix="/codes")


@router.get("")
def list_codes(request: Request, caller: Looker) -> HTMLResponse:
    """List all codes, by family."""
    return page(request, caller, "codes/list.html", families=by_family())


@router.get("/{code}")
def show_code(code: str, request: Request, caller: Looker) -> HTMLResponse:
    """Show one code. Raises `NotFoundError`."""
    meaning = CATALOGUE.get(RENAMED.get(code, code))
    if meaning is None:
        raise NotFoundError("code", code)
    return page(
        request,
        caller,
        "codes/one.html",
        one=meaning,
        family=next(title for title, codes in by_family().items() if meaning in codes),
        others=meaning.differing,
        harm_sentences=HARM_SENTENCES,
        is_of_profile=code in PROFILE_CODES,
    )
