"""`stone explain`: what a code of a finding or of a failed run means, without a server."""

from dataclasses import asdict
from typing import Annotated, Any

import typer

from stone_base.codes.catalogue import CATALOGUE
from stone_base.codes.meaning import HARM_SENTENCES, HARM_WORDS, CodeMeaning
from stone_base.codes.renamed import RENAMED
from stone_base.errors import Refused
from stone_client.streams import JsonOption, echo_json


def explain(
    code: Annotated[str, typer.Argument(metavar="CODE", help="The code (default: all).")] = "",
    as_json: JsonOption = False,
) -> None:
    """Explain a code: what it means, whether it harms labels, and what to do."""
    if not code:
        return _list(as_json)
    named = RENAMED.get(code, code)
    one = {_bare(known): entry for known, entry in CATALOGUE.items()}.get(_bare(named))
    if one is None and code in RENAMED:
        return _refusal(code, named, as_json)
    if one is None:
        raise Refused(
            "unknown_code",
            f"{code[:80]!r} is not the code of a finding or of a failed run; `stone explain` lists all codes",
        )
    if as_json:
        return echo_json(_record(one))
    if code in RENAMED:
        typer.echo(f"{code} is the earlier name of {named}.\n")
    typer.echo(f"{one.code}: {HARM_WORDS[one.harm]}\n")
    others = (
        f" As {'an error' if word == 'error' else 'a warning'}: {HARM_WORDS[harm]}."
        for word, harm in one.differing.items()
    )
    typer.echo(f"{one.meaning}\n\nDoes it harm labels? {HARM_SENTENCES[one.harm]}{''.join(others)}")
    typer.echo(f"What to do: {one.remedy}")


def _refusal(old: str, new: str, as_json: bool) -> None:
    """Name the current code of a refusal, whose meaning the server knows."""
    if as_json:
        return echo_json({"code": new, "earlier_name": old, "described_at": f"/api/v1/problems/{new}"})
    typer.echo(f"{old} is the earlier name of {new}, a refusal of the server.")
    typer.echo(f"The server describes it at /api/v1/problems/{new}; the reference lists all codes.")


def _list(as_json: bool) -> None:
    if as_json:
        return echo_json({"codes": [_record(one) for one in CATALOGUE.values()]})
    for one in CATALOGUE.values():
        typer.echo(f"{one.code}  {HARM_WORDS[one.harm]}: {one.meaning}")


def _bare(code: str) -> str:
    """Return the code as `LAB-603`, `lab603` and `Lab 603` share it."""
    return "".join(sign for sign in code.lower() if sign.isalnum())


def _record(one: CodeMeaning) -> dict[str, Any]:
    return {key: value for key, value in asdict(one).items() if value is not None}
