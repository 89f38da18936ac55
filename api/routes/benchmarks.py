"""Routes of benchmarks, phases and metrics.

**Conventions.** Signed-in users can read all benchmarks, visitors only public ones. Here a phase is addressed by the
names of its benchmark and itself, elsewhere by its id. The manifest belongs to the active ground truth. Ground truth
has no route; `frame_pictures.py` returns top-view pictures of open ground truth.
"""

from hashlib import sha256
from typing import Annotated, Literal

from fastapi import APIRouter, Depends, Query, Request, Response
from sqlalchemy.orm import Session

from api.answers import Responses, refusals
from api.deps import Looker, PlatformDep, Reader, at_once
from api.etags import set_head
from api.files import ServedFile, StoredFile, answer_bytes, answer_file, file_responses
from api.paging import Page, PageDep, page
from api.schemas.base import IdPath
from api.schemas.benchmarks import BenchmarkDetail, BenchmarkItem, MetricItem, PhaseItem
from api.schemas.phase_bodies import BenchmarkName, MetricName, PhaseName
from api.views.benchmarks import benchmark_detail, benchmark_items, known_metric, metric_item, phase_item
from api.visible import benchmark_of, benchmarks_of, phase_at, phase_id_at, phase_of
from services.domain.benchmarks.golden import golden_archive
from services.domain.benchmarks.phases import evaluation_versions
from services.domain.benchmarks.phases.errors import no_ground_truth
from services.domain.benchmarks.starter import manifest_filename
from services.runtime.orm import Benchmark, Blob, GroundTruthRow, Phase

router = APIRouter(tags=["benchmarks"])
AT = "/benchmarks/{benchmark_name}/phases/{phase_name}"
MANIFEST = file_responses("application/json")
VECTORS = file_responses("application/zip")
Form = Annotated[
    Literal["json", "markdown"],
    Query(alias="format", description="Format of the answer; `markdown` is the definition alone."),
]
MARKDOWN: Responses = {200: {"content": {"text/markdown": {"schema": {"type": "string"}}}}}


class PhasePath:
    """A phase by the names of its benchmark and itself."""

    def __init__(self, benchmark_name: BenchmarkName, phase_name: PhaseName, caller: Looker) -> None:
        self.benchmark, self.phase, self._caller = benchmark_name, phase_name, caller

    def find(self, session: Session) -> Phase:
        """Return the phase. Raises `NotFoundError`."""
        return phase_at(session, self._caller, self.benchmark, self.phase)

    def find_id(self, session: Session) -> str:
        """Return only the phase's id. Raises `NotFoundError`."""
        return phase_id_at(session, self._caller, self.benchmark, self.phase)


AtPhase = Annotated[PhasePath, Depends(at_once(PhasePath))]


@router.get("/benchmarks", responses=refusals())
def list_benchmarks(caller: Looker, platform: PlatformDep, query: PageDep) -> Page[BenchmarkItem]:
    """List the benchmarks, newest first."""
    with platform.database.reading() as session:
        benchmarks = page(session, benchmarks_of(caller), Benchmark.id.desc(), query)
        return Page[BenchmarkItem](items=benchmark_items(session, benchmarks.rows), next=benchmarks.next)


@router.get("/benchmarks/{benchmark_name}", responses=refusals(404))
def show_benchmark(benchmark_name: BenchmarkName, caller: Looker, platform: PlatformDep) -> BenchmarkDetail:
    """Show a benchmark with its phases."""
    with platform.database.reading() as session:
        return benchmark_detail(session, benchmark_of(session, caller, benchmark_name))


@router.get(AT, summary="Show a phase", responses=refusals(404))
def show_named_phase(at: AtPhase, platform: PlatformDep, response: Response) -> PhaseItem:
    """Return rules, dates, limits of a team, ground truth and metric, and visibility."""
    with platform.database.reading() as session:
        return _shown(session, at.find(session), response)


@router.get("/phases/{phase_id}", summary="Show a phase by its id", responses=refusals(404))
def show_phase(phase_id: IdPath, _caller: Reader, platform: PlatformDep, response: Response) -> PhaseItem:
    """Return the phase as by its names."""
    with platform.database.reading() as session:
        return _shown(session, phase_of(session, phase_id), response)


@router.get(
    f"{AT}/manifest",
    summary="Download a phase's manifest of frames",
    response_class=Response,
    responses=MANIFEST | refusals(409),
)
def download_phase_manifest(at: AtPhase, platform: PlatformDep, request: Request) -> Response:
    """Return the frames that a submission must contain, as `stone validate --manifest` reads them."""
    with platform.database.reading() as session:
        phase = at.find(session)
        pair = evaluation_versions.active(session, phase.id)
        if pair is None:
            raise no_ground_truth(phase.name)
        blob = session.get_one(Blob, session.get_one(GroundTruthRow, pair.truth_id).manifest_sha256)
    named = manifest_filename(at.benchmark, at.phase)
    file = StoredFile(blob.object_key, blob.size_bytes, blob.sha256, "application/json", named)
    return answer_file(request, platform.store, file)


@router.get(
    f"{AT}/metrics/{{metric}}",
    summary="Show the metric's definition",
    response_model=MetricItem,
    responses=MARKDOWN | refusals(404),
)
def show_metric(at: AtPhase, metric: MetricName, platform: PlatformDep, form: Form = "json") -> MetricItem | Response:
    """Return the definition of one metric version, and whether the phase is scored by it."""
    with platform.database.reading() as session:
        shown = metric_item(session, at.find(session), metric)
    if form == "markdown":
        return Response(shown.definition, media_type="text/markdown; charset=utf-8")
    return shown


@router.get(
    f"{AT}/metrics/{{metric}}/vectors",
    summary="Download the metric's test vectors",
    response_class=Response,
    responses=VECTORS,
)
def download_metric_vectors(at: AtPhase, metric: MetricName, platform: PlatformDep, request: Request) -> Response:
    """Return grids with their scores, to check another implementation of the metric."""
    with platform.database.reading() as session:
        at.find(session)
    named = f"{known_metric(metric).version}.vectors.zip"
    content = golden_archive()
    digest = sha256(content).hexdigest()
    served = ServedFile(
        len(content), digest, "application/zip", named, lambda start, stop: iter((content[start:stop],)), ()
    )
    return answer_bytes(request, served)


def _shown(session: Session, phase: Phase, response: Response) -> PhaseItem:
    return set_head(response, phase_item(session, phase), tag=phase.revision)
