"""Losses of masks: voxels that are drawn, queries that are matched, terms against formulas written out."""

from itertools import permutations

import pytest
import torch
from torch import Tensor
from torch.nn import functional

from baselines.batch import IGNORED
from baselines.layers.masked_attention import MaskPrediction
from baselines.losses.mask_points import (
    PointSettings,
    contested_voxels,
    drawn_voxels,
    frame_masks,
    read_masks,
)
from baselines.losses.masks import MaskLossSettings, mask_losses, matched_queries, matching_cost

SETTINGS = MaskLossSettings((1000, 10, 100, 200), PointSettings(points=4_000))  # more than there are voxels: all
SHAPE = (8, 6, 4)


@pytest.fixture(autouse=True)
def _seeded() -> None:
    torch.manual_seed(0)
    torch.set_num_threads(1)


def random_labels() -> Tensor:
    labels = torch.randint(0, 4, SHAPE, dtype=torch.uint8)
    labels[:2] = IGNORED
    return labels


def rarity() -> Tensor:
    return torch.tensor(SETTINGS.rarity())


def perfect(labels: Tensor, queries: int = 6) -> MaskPrediction:
    """Queries 1 to 4 are sure of a class and its voxels, the others of nothing."""
    classes = torch.full((1, queries, 5), -20.0)
    classes[0, :, 4] = 20.0
    masks = torch.full((1, queries, *labels.shape), -20.0)
    for label in range(4):
        classes[0, label + 1, 4], classes[0, label + 1, label] = -20.0, 20.0
        masks[0, label + 1][labels == label] = 20.0
    return MaskPrediction(classes, masks)


@pytest.mark.parametrize("align_corners", [False, True])
@pytest.mark.parametrize("shape", [(4, 3, 2), (8, 6, 4)])
def test_reading_at_every_voxel_is_resampling(align_corners: bool, shape: tuple[int, int, int]) -> None:
    masks = torch.randn(2, 3, *shape)
    voxels = torch.arange(8 * 6 * 4).expand(2, -1)
    expected = functional.interpolate(masks, size=SHAPE, mode="trilinear", align_corners=align_corners).flatten(2)
    torch.testing.assert_close(read_masks(masks, voxels, SHAPE, align_corners), expected, atol=1e-5, rtol=1e-5)


def test_drawn_voxels_differ_are_labelled_and_follow_the_seed() -> None:
    frame = frame_masks(random_labels(), rarity())
    torch.manual_seed(3)
    voxels = drawn_voxels(frame.rarity, 2, 40)
    assert all(len(set(row)) == 40 for row in voxels.tolist())
    assert (frame.rarity[voxels] > 0).all()
    torch.manual_seed(3)
    assert torch.equal(voxels, drawn_voxels(frame.rarity, 2, 40))
    assert sorted(drawn_voxels(frame.rarity, 1, 10_000)[0].tolist()) == frame.rarity.nonzero()[:, 0].tolist()


def test_rare_classes_are_drawn_in_proportion_to_the_fourth_root_of_their_rarity() -> None:
    labels = torch.zeros(100, 100, 2, dtype=torch.uint8)
    labels[:, :, 1] = 1
    frame = frame_masks(labels, rarity())
    drawn = drawn_voxels(frame.rarity, 10, 1_000) % 2
    assert drawn.float().mean().item() == pytest.approx(100**0.25 / (1 + 100**0.25), abs=0.02)


def test_three_quarters_of_the_voxels_are_the_least_decided_of_those_drawn() -> None:
    labels = torch.zeros(10, 10, 10, dtype=torch.uint8)
    masks = torch.full((1, 10, 10, 10), 9.0)
    masks[0, :3] = 0.1
    settings = PointSettings(points=100)
    voxels = contested_voxels(masks, frame_masks(labels, rarity()), settings)[0]
    assert len(voxels) == 100
    assert masks.flatten()[voxels[:75]].tolist() == pytest.approx([0.1] * 75)
    assert len(set(voxels[:75].tolist())) == 75


def test_the_cost_of_a_match_is_the_formula_written_out() -> None:
    classes, logits = torch.randn(3, 5), torch.randn(3, 7)
    present, targets = torch.tensor([0, 2]), (torch.rand(2, 7) > 0.5).float()
    cost = matching_cost(classes, logits, present, targets, SETTINGS)
    for query, row in enumerate(logits):
        for number, target in enumerate(targets):
            chance, covered = classes[query].softmax(0)[present[number]], row.sigmoid()
            entropy = -(target * covered.log() + (1 - target) * (1 - covered).log()).mean()
            dice = 1 - (2 * (covered * target).sum() + 1) / (covered.sum() + target.sum() + 1)
            torch.testing.assert_close(cost[query, number], -2 * chance + 5 * entropy + 5 * dice)


def test_queries_are_matched_at_the_least_cost_of_all_permutations() -> None:
    labels = random_labels()
    frame = frame_masks(labels, rarity())
    classes, masks = torch.randn(6, 5), torch.randn(6, *SHAPE)
    queries = matched_queries(classes, masks, frame, SETTINGS)
    counted = frame.rarity > 0
    logits, targets = masks.flatten(1)[:, counted], frame.masks[:, counted].float()
    cost = matching_cost(classes, logits, frame.classes, targets, SETTINGS).tolist()
    best = min(permutations(range(6), 4), key=lambda some: sum(cost[q][g] for g, q in enumerate(some)))
    assert queries.tolist() == list(best)


def test_a_perfect_prediction_costs_nothing_and_a_wrong_one_much() -> None:
    labels = random_labels()
    right = mask_losses([perfect(labels)], labels[None], SETTINGS)
    moved = mask_losses([perfect(labels.flip(0))], labels[None], SETTINGS)
    renamed = mask_losses([perfect((labels + 1) % 4)], labels[None], SETTINGS)
    assert all(term.item() == pytest.approx(0.0, abs=1e-3) for term in right.values())
    assert min(moved["mask"], moved["dice"]).item() > 1.0
    assert renamed["class"].item() > 1.0


def test_terms_are_the_formulas_written_out_summed_over_predictions() -> None:
    labels = random_labels()
    frame = frame_masks(labels, rarity())
    predictions = [MaskPrediction(torch.randn(1, 6, 5), torch.randn(1, 6, *SHAPE)) for _ in range(2)]
    expected = torch.zeros(3)
    weights = torch.tensor([1.0, 3.0, 1.5, 1.3037472, 0.1])  # ln 1000 / ln count
    for prediction in predictions:
        queries = matched_queries(prediction.classes[0], prediction.masks[0], frame, SETTINGS)
        asked = torch.full((6,), 4)
        asked[queries] = torch.arange(4)
        expected[0] += 2 * functional.cross_entropy(prediction.classes[0], asked, weights)
        for label in range(4):
            target = (labels == label)[labels != IGNORED].float().repeat(2)  # drawn as undecided, and uniformly
            logits = prediction.masks[0, queries[label]][labels != IGNORED].repeat(2)
            share = weights[label] / weights[:4].sum()
            expected[1] += 5 * share * functional.binary_cross_entropy_with_logits(logits, target)
            covered = logits.sigmoid()
            dice = 1 - (2 * (covered * target).sum() + 1) / (covered.sum() + target.sum() + 1)
            expected[2] += 5 * share * dice
    terms = mask_losses(predictions, labels[None], SETTINGS)
    torch.testing.assert_close(torch.stack([terms["class"], terms["mask"], terms["dice"]]), expected)


def test_frames_of_other_classes_or_of_none_are_learnt_from_together() -> None:
    labels = torch.stack([random_labels(), torch.full(SHAPE, IGNORED, dtype=torch.uint8), random_labels() % 2])
    classes = torch.randn(3, 6, 5, requires_grad=True)
    masks = torch.randn(3, 6, 4, 3, 2, requires_grad=True)
    terms = mask_losses([MaskPrediction(classes, masks)], labels, SETTINGS)
    sum(terms.values()).backward()  # type: ignore[union-attr]
    assert (classes.grad.abs().sum(dim=(1, 2)) > 0).all()
    assert (masks.grad.abs().flatten(1).sum(dim=1) > 0).tolist() == [True, False, True]


def test_a_batch_without_a_label_has_finite_terms() -> None:
    labels = torch.full((1, *SHAPE), IGNORED, dtype=torch.uint8)
    masks = torch.randn(1, 6, 4, 3, 2, requires_grad=True)
    terms = mask_losses([MaskPrediction(torch.randn(1, 6, 5), masks)], labels, SETTINGS)
    assert terms["mask"].item() == terms["dice"].item() == 0.0
    assert terms["class"].isfinite()
    (terms["mask"] + terms["dice"]).backward()
    assert masks.grad is not None


def test_a_class_that_is_never_seen_has_no_weight() -> None:
    with pytest.raises(ValueError, match="more than one voxel each"):
        MaskLossSettings((1000, 1, 100, 200))
