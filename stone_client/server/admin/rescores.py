"""Paths of re-scores, by benchmark, phase and id (or latest)."""

from stone_base.errors import Refused
from stone_client.api import Api
from stone_client.server.benchmarks import administered_phase
from stone_client.server.ids import chosen_id


def rescores_path(api: Api, benchmark: str, phase: str) -> str:
    return f"{administered_phase(api, benchmark, phase)}/rescores"


def rescore_path(api: Api, benchmark: str, phase: str, named: str) -> str:
    """Return the path of the re-score with this id or short id; `latest` is the newest. Raises `no_rescore`."""
    path = rescores_path(api, benchmark, phase)
    ids = [str(rescore["id"]) for rescore in api.pages(path)]
    rescore_id = named if named in ids else chosen_id(named, ids)
    if rescore_id is None:
        raise Refused(
            "no_rescore",
            f"{named[:80]!r} is not a re-score of {benchmark} / {phase}; give an id or latest (it has {len(ids)}; "
            "`stone admin rescores list` lists them)",
        )
    return f"{path}/{rescore_id}"
