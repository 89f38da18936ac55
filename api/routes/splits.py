"""Routes of the draft splits: read, check, replace, propose by a solver.

**Conventions.** There is one set of draft splits, which administrators save. All users see its sizes and the splits of
their own sequences. Broken rules are errors that refuse the splits; rules that the data cannot satisfy are warnings.
The solver is loaded at its first use.
"""

from fastapi import APIRouter, Request, Response

from api import audit
from api.answers import refusals
from api.deps import Administrator, PlatformDep, Reader
from api.errors import split_refused
from api.etags import etag, require_match, set_head
from api.schemas.splits import (
    ProposalAnswer,
    ProposalBody,
    SplitsAnswer,
    SplitsBody,
    SplitsToJudge,
    VerdictsAnswer,
)
from api.views.splits import gap_item, proposal_answer, rule_items, splits_answer
from api.visible import sequences_of
from services.domain.datasets.catalogue import entries_of, labelled_sequences
from services.domain.datasets.splits import current_splits, errors_of, judged, lock_splits, replace_splits
from stone.splits.splits import Split

router = APIRouter(prefix="/splits", tags=["dataset"])


@router.get("", summary="Show the draft splits and the verdicts of the rules", responses=refusals())
def show_splits(caller: Reader, platform: PlatformDep, response: Response) -> SplitsAnswer:
    """Return all sequences with the verdicts to administrators, and only their own sequences to other users."""
    with platform.database.reading() as session:
        current = current_splits(session)
        seen = labelled_sequences(session, sequences_of(caller))
    response.headers["ETag"] = etag(current.revision)
    findings = judged(current.split, seen) if caller.is_administrator else None
    return splits_answer(current, entries_of(seen), findings)


@router.put("", summary="Save the draft splits", responses=refusals(409, 412, 428))
def put_splits(
    body: SplitsBody, caller: Administrator, platform: PlatformDep, request: Request, response: Response
) -> SplitsAnswer:
    """Replace all splits at once. 422 names every broken rule; the response contains warnings."""
    split = Split(tuple(body.train), tuple(body.val), tuple(body.test))
    with platform.database.transaction() as session:
        row = lock_splits(session)
        require_match(request, row.revision)
        labelled = labelled_sequences(session)
        findings = judged(split, labelled)
        if errors := errors_of(findings):
            raise split_refused(errors, {sequence.entry.id: sequence.entry.name for sequence in labelled})
        replace_splits(session, row, split)
        facts = dict(zip(("train", "val", "test"), split.sizes, strict=True)) | {"revision": row.revision}
        audit.record_admin_act(session, caller, "splits.put", row.name, body.reason, facts)
        current = current_splits(session)
    return set_head(response, splits_answer(current, entries_of(labelled), findings), tag=current.revision)


@router.post("/verdicts", summary="Check splits against the rules", responses=refusals())
def judge_splits(body: SplitsToJudge, _caller: Administrator, platform: PlatformDep) -> VerdictsAnswer:
    """Return the verdict of every rule. Saves nothing."""
    split = Split(tuple(body.train), tuple(body.val), tuple(body.test))
    with platform.database.reading() as session:
        revision = current_splits(session).revision
        labelled = labelled_sequences(session)
    findings, gap = judged(split, labelled), gap_item(split, entries_of(labelled))
    return VerdictsAnswer(revision=revision, can_be_put=not errors_of(findings), findings=rule_items(findings), gap=gap)


@router.post("/proposal", summary="Propose splits of given sizes", responses=refusals(409))
def propose_splits(body: ProposalBody, caller: Administrator, platform: PlatformDep) -> ProposalAnswer:
    """Return balanced splits that keep every rule, or the rules that conflict. Saves nothing."""
    from stone.splits.proposal import propose

    left_out = set(body.leave_out)
    with platform.database.reading() as session:
        seen = entries_of(labelled_sequences(session))
    entries = tuple(entry for entry in seen if entry.id not in left_out)
    sizes = body.sizes
    return proposal_answer(propose(entries, (sizes.train, sizes.val, sizes.test)), entries)
