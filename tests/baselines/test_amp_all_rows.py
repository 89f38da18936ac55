"""Mixed precision: under autocast a row answers nearly as in float32, and learns in nearly the same direction.

A row is added by a maker of a small model without dropout and one of a batch for it.
"""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch

from baselines.batch import Batch
from tests.baselines.test_tpvformer import SMALL, batch_of, model_of

torch.set_num_threads(1)
CALM = replace(SMALL, dropout=0.0)
Makers = tuple[Callable[[], torch.nn.Module], Callable[[], Batch]]
ROWS: dict[str, Makers] = {"TPVFormer": (lambda: model_of(CALM), lambda: batch_of(CALM))}
every_row = pytest.mark.parametrize("row", ROWS)


def trained_once(row: str, is_half: bool) -> tuple[torch.Tensor, dict[str, torch.Tensor], torch.Tensor]:
    """Logits, losses, and gradients of all parameters in a row."""
    make_model, make_batch = ROWS[row]
    model, batch = make_model(), make_batch()
    with torch.autocast("cpu", torch.bfloat16, enabled=is_half):
        outputs = model(batch)
        losses = model.losses(outputs, batch)
        logits = model.logits(outputs, batch)
    torch.stack(list(losses.values())).sum().backward()
    gradients = [p.grad.flatten() for p in model.parameters() if p.grad is not None]
    return logits.detach(), losses, torch.cat(gradients)


@every_row
def test_logits_and_losses_are_single_precision_under_autocast(row: str) -> None:
    logits, losses, gradients = trained_once(row, is_half=True)
    assert logits.dtype == torch.float32
    assert {loss.dtype for loss in losses.values()} == {torch.float32}
    assert gradients.isfinite().all()


@every_row
def test_answers_and_losses_are_nearly_those_of_single_precision(row: str) -> None:
    (half, half_losses, _), (single, single_losses, _) = (
        trained_once(row, is_half=True),
        trained_once(row, is_half=False),
    )
    assert (half - single).abs().mean() < 0.05 * single.std()
    for name, loss in single_losses.items():
        torch.testing.assert_close(half_losses[name], loss, rtol=0.02, atol=0.02)


@every_row
def test_gradients_point_nearly_the_same_way(row: str) -> None:
    (_, _, half), (_, _, single) = trained_once(row, is_half=True), trained_once(row, is_half=False)
    assert torch.cosine_similarity(half, single, dim=0) > 0.95
