"""`stone explain`: the meaning of a code of a finding or a failed run, without a server."""

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
    """Explain a code: its meaning, whether it harms labels, and what to do."""
    if not code:
        return _list(as_json)
    named = RENAMED.get(code, code)
    meaning = {_bare(known): entry for known, entry in CATALOGUE.items()}.get(_bare(named))
    if meaning is None and code in RENAMED:
        return _refusal(code, named, as_json)
    if meaning is None:
        raise Refused(
            "unknown_code",
            f"{code[:80]!r} is not the code of a finding or of a failed run; `stone explain` lists all codes",
        )
    if as_json:
        return echo_json(_record(meaning))
    if code in RENAMED:
        typer.echo(f"{code} is the earlier name of {named}.\n")
    typer.echo(f"{meaning.code}: {HARM_WORDS[meaning.harm]}\n")
    others = (
        f" As {'an error' if word == 'error' else 'a warning'}: {HARM_WORDS[harm]}."
        for word, harm in meaning.differing.items()
    )
    typer.echo(f"{meaning.meaning}\n\nDoes it harm labels? {HARM_SENTENCES[meaning.harm]}{''.join(others)}")
    typer.echo(f"What to do: {meaning.remedy}")


def _refusal(old: str, new: str, as_json: bool) -> None:
    """Print the current code of a renamed refusal; the server explains it."""
    if as_json:
        return echo_json({"code": new, "earlier_name": old, "described_at": f"/api/v1/problems/{new}"})
    typer.echo(f"{old} is the earlier name of {new}, a refusal of the server.")
    typer.echo(f"The server describes it at /api/v1/problems/{new}; the reference lists all codes.")


def _list(as_json: bool) -> None:
    if as_json:
        return echo_json({"codes": [_record(meaning) for meaning in CATALOGUE.values()]})
    for meaning in CATALOGUE.values():
        typer.echo(f"{meaning.code}  {HARM_WORDS[meaning.harm]}: {meaning.meaning}")


def _bare(code: str) -> str:
    """Return the code in the form that `LAB-603`, `lab603` and `Lab 603` share."""
    return "".join(sign for sign in code.lower() if sign.isalnum())


def _record(meaning: CodeMeaning) -> dict[str, Any]:
    return {key: value for key, value in asdict(meaning).items() if value is not None}
