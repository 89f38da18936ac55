"""Sequences for the list: labelled ones with a real picture of their grid from above, one half-way, one empty."""

from typing import Any

import httpx
import numpy as np
from PIL import Image

from services.domain.viewer.frame_picture import plan_indices, png_of
from services.runtime.database.inserts import insert_new
from services.runtime.orm import SplitMember
from services.runtime.platform import Platform
from testing.api.serving import Person
from testing.worlds import made
from testing.worlds.benchmark_world import ground, labels_npz

DRIVEN = (("farmland", "day"), ("mountain", "dusk"), ("lake", "night"), ("construction", "sunny"))


def picture_of(seed: int) -> bytes:
    """The grid from above as labels are drawn, 640 × 400, with nothing round it."""
    shown = np.pad(plan_indices(ground(seed))[58:198, 16:240], ((10, 10), (16, 16)))
    return png_of(np.asarray(Image.fromarray(shown).resize((640, 400), Image.Resampling.NEAREST)))


def listed_world(platform: Platform, api: httpx.Client, owner: Person) -> list[dict[str, Any]]:
    """Four that are labelled, of which the first is public and each is in a split or none; two that are not."""
    sequences = []
    for number, (environment, illumination) in enumerate(DRIVEN):
        said = {"environment": environment, "illumination": illumination, "region": "Gyeonggi", "platform": "warthog-1"}
        one = made.sequence(api, owner, f"{environment}-2026-05-0{number + 1}", **said)
        labels = made.labels(platform, one, seed=bytes([number]), contents=[labels_npz(ground(number))])
        with platform.database.transaction() as session:
            made._artefact(session, platform, labels.id, "thumbnail.png", picture_of(number))
        sequences.append(one)
    with platform.database.transaction() as session:
        parts = zip(sequences, ("train", "val", "test"), strict=False)
        insert_new(session, SplitMember, [{"sequence_id": one["id"], "part": part} for one, part in parts])
    sequences.append(made.sequence(api, owner, "being-processed"))
    made.run(platform, owner, "ingest.synchronise", sequence_id=sequences[-1]["id"])
    sequences.append(made.sequence(api, owner, "only-a-name"))
    path, headers = f"/api/v1/sequences/{sequences[0]['id']}", {**owner.headers, "If-Match": "*"}
    assert api.patch(path, headers=headers, json={"is_public": True}).status_code == 200
    return sequences
