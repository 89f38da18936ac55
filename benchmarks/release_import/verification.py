"""Comparison of an import with the dataset: each frame exists once, with the published bytes."""

from collections import Counter
from hashlib import sha256

from stone_client.api import Api
from testing.worlds.published_datasets import SyntheticDataset

STEP = 97  # one frame in so many is compared by its bytes


class ImportedWronglyError(Exception):
    """The imported data differ from the published data."""


def verified(api: Api, dataset: SyntheticDataset) -> str:
    """Return a summary of the comparison. Raises `ImportedWronglyError`."""
    sequences = {item["name"]: item["id"] for item in api.pages("/sequences")}
    if sorted(sequences) != sorted(dataset.names):
        raise ImportedWronglyError(f"sequences {sorted(sequences)}")
    published = [sha256(labels).hexdigest() for labels in dataset.labels]
    frames = compared = 0
    for scene, name in enumerate(dataset.names):
        tokens = Counter(item["token"] for item in api.pages(f"/sequences/{sequences[name]}/frames"))
        if tokens != Counter(dataset.tokens(scene)):
            raise ImportedWronglyError(f"{name} has {tokens.total()} frames, {len(tokens)} of them different")
        frames += len(tokens)
        for frame, token in list(enumerate(dataset.tokens(scene)))[::STEP]:
            content = api.send("GET", f"/frames/{token}/labels.npz").content
            if sha256(content).hexdigest() != published[frame % len(published)]:
                raise ImportedWronglyError(f"labels of {name} {token}")
            compared += 1
    return f"{len(sequences)} sequences, {frames} frames once each; labels of {compared} compared, all equal"
