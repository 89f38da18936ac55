"""What stands after an import, held against the dataset: each frame once, with the bytes that were published."""

from collections import Counter
from hashlib import sha256

from stone_client.api import Api
from testing.worlds.published_datasets import SyntheticDataset

STEP = 97  # of every so many frames the bytes are compared


class ImportedWronglyError(Exception):
    """What stands is not what was published."""


def verified(api: Api, dataset: SyntheticDataset) -> str:
    """What was compared. Raises `ImportedWronglyError`."""
    sequences = {one["name"]: one["id"] for one in api.pages("/sequences")}
    if sorted(sequences) != sorted(dataset.names):
        raise ImportedWronglyError(f"sequences {sorted(sequences)}")
    published = [sha256(labels).hexdigest() for labels in dataset.labels]
    frames = compared = 0
    for scene, name in enumerate(dataset.names):
        tokens = Counter(one["token"] for one in api.pages(f"/sequences/{sequences[name]}/frames"))
        if tokens != Counter(dataset.tokens(scene)):
            raise ImportedWronglyError(f"{name} has {tokens.total()} frames, {len(tokens)} of them different")
        frames += len(tokens)
        for frame, token in list(enumerate(dataset.tokens(scene)))[::STEP]:
            content = api.send("GET", f"/frames/{token}/labels.npz").content
            if sha256(content).hexdigest() != published[frame % len(published)]:
                raise ImportedWronglyError(f"labels of {name} {token}")
            compared += 1
    return f"{len(sequences)} sequences, {frames} frames once each; labels of {compared} compared, all equal"
