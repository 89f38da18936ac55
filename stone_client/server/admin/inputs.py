"""Inputs of a phase or of a dataset version: the data for prediction and training."""

from typing import Any

from stone_client.api import Api
from stone_client.progress import reported
from stone_client.server.job_following import follow


def create_inputs(api: Api, own: str, reason: str, *, is_awaited: bool) -> dict[str, Any]:
    """Create the missing inputs of the phase or version at the path `own`; return its `job` and all `inputs`."""
    job = dict(api.create(f"/admin{own}/inputs", {"reason": reason}))
    if is_awaited:
        with reported() as progress:
            job = dict(follow(api, job["id"], progress))
    return {"job": job, "inputs": list(api.pages(f"{own}/inputs"))}
