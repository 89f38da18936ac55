"""ORM models of benchmarks: phases, ground truths, activations, re-scores, reported results.

**Conventions.** A ground truth is immutable once it is ready: foreign keys to blobs keep its contents. The board of a
phase shows one evaluation version (a ground truth and a metric) at a time, that of its newest activation.
"""

from sqlalchemy import JSON, ForeignKey, Index, String, Text, false, text
from sqlalchemy.orm import Mapped, mapped_column

from services.runtime.orm.base import Base, Bytes, Id, Ns, Record, new_id, now_ns


class Benchmark(Base):
    """`name` is used in URLs; `title` and `description` are plain text. A public benchmark requires no account."""

    __tablename__ = "benchmarks"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    name: Mapped[str] = mapped_column(String(64), unique=True)
    title: Mapped[str] = mapped_column(String(200), default="")
    description: Mapped[str] = mapped_column(Text, default="")
    is_public: Mapped[bool] = mapped_column(default=False, server_default=false())
    created_by: Mapped[Id] = mapped_column(ForeignKey("users.id"))
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)


class Phase(Base):
    """One part of a dataset version to predict, and the phase's rules.

    `mask` selects the evaluated voxels (all, lidar, camera). While `is_hidden`, only rounded totals of its ground truth
    are shown, until `closes_ns`. `scorings_per_window` and `scorings_total` limit a team's scored submissions; null
    means no limit. Team names are shown from `named_from_ns` on. `revision` counts changes (ETag).

    With `every_nth`, inputs and ground truth are one frame in `every_nth`, without poses, stamps or order, under tokens
    made with `token_key`; null means all frames, unchanged.
    """

    __tablename__ = "phases"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    benchmark_id: Mapped[Id] = mapped_column(ForeignKey("benchmarks.id", ondelete="CASCADE"))
    name: Mapped[str] = mapped_column(String(32))
    title: Mapped[str] = mapped_column(String(200), default="")
    dataset_id: Mapped[Id] = mapped_column(ForeignKey("datasets.id"), index=True)
    part: Mapped[str] = mapped_column(String(8))
    mask: Mapped[str] = mapped_column(String(8), default="all")
    is_hidden: Mapped[bool]
    every_nth: Mapped[int | None]
    token_key: Mapped[str | None] = mapped_column(String(64))
    opens_ns: Mapped[Ns | None] = mapped_column(index=True)
    closes_ns: Mapped[Ns | None] = mapped_column(index=True)
    named_from_ns: Mapped[Ns | None]
    scorings_per_window: Mapped[int | None]
    window_ns: Mapped[Ns] = mapped_column(default=7 * 86_400 * 10**9)
    scorings_total: Mapped[int | None]
    validations_per_day: Mapped[int] = mapped_column(default=20)
    team_members: Mapped[int] = mapped_column(default=10)
    revision: Mapped[int] = mapped_column(default=1)
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)

    __table_args__ = (Index("uq_phases_benchmark_name", "benchmark_id", "name", unique=True),)


class GroundTruthRow(Base):
    """A version of a phase's ground truth; `ready_ns` is null until its job has succeeded.

    `sha256` covers every evaluated voxel and is part of a score's signature. `facts` contain each sequence's frames,
    environment, illumination and region, in the order of the manifest.
    """

    __tablename__ = "ground_truths"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    phase_id: Mapped[Id] = mapped_column(ForeignKey("phases.id", ondelete="CASCADE"))
    number: Mapped[int]
    dataset_id: Mapped[Id] = mapped_column(ForeignKey("datasets.id"), index=True)
    part: Mapped[str] = mapped_column(String(8))
    mask: Mapped[str] = mapped_column(String(8))
    job_id: Mapped[Id | None] = mapped_column(ForeignKey("jobs.id"))
    sha256: Mapped[str] = mapped_column(String(64), default="")
    frames: Mapped[int] = mapped_column(default=0)
    manifest_sha256: Mapped[str | None] = mapped_column(ForeignKey("blobs.sha256"), index=True)
    pack_sha256: Mapped[str | None] = mapped_column(ForeignKey("blobs.sha256"), index=True)
    facts: Mapped[Record] = mapped_column(JSON, default=dict)
    created_by: Mapped[Id] = mapped_column(ForeignKey("users.id"))
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)
    ready_ns: Mapped[Ns | None]

    __table_args__ = (Index("uq_ground_truths_phase_number", "phase_id", "number", unique=True),)


class Activation(Base):
    """The evaluation version on the phase's board from `activated_ns` on; the newest counts. Rows are only added."""

    __tablename__ = "activations"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    phase_id: Mapped[Id] = mapped_column(ForeignKey("phases.id", ondelete="CASCADE"), index=True)
    truth_id: Mapped[Id] = mapped_column(ForeignKey("ground_truths.id"), index=True)
    metric: Mapped[str] = mapped_column(String(32))
    rescore_id: Mapped[Id | None] = mapped_column(ForeignKey("rescores.id"))
    activated_by: Mapped[Id] = mapped_column(ForeignKey("users.id"))
    activated_ns: Mapped[Ns] = mapped_column(default=now_ns)


class Rescore(Base):
    """The scoring of all entries on a phase's board by another evaluation version; `job_id` is the run of its jobs."""

    __tablename__ = "rescores"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    phase_id: Mapped[Id] = mapped_column(ForeignKey("phases.id", ondelete="CASCADE"), index=True)
    truth_id: Mapped[Id] = mapped_column(ForeignKey("ground_truths.id"), index=True)
    metric: Mapped[str] = mapped_column(String(32))
    job_id: Mapped[Id | None] = mapped_column(ForeignKey("jobs.id"))
    reason: Mapped[str] = mapped_column(String(512), default="")
    created_by: Mapped[Id] = mapped_column(ForeignKey("users.id"))
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)
    activated_ns: Mapped[Ns | None]
    abandoned_ns: Mapped[Ns | None]


class Reported(Base):
    """A published result or a ceiling (`kind`): on the board, marked as not scored here, and never ranked.

    `note` is a remark for readers beside its source; `percent_digits` are the decimals of its per cent as printed.
    """

    __tablename__ = "reported"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    phase_id: Mapped[Id] = mapped_column(ForeignKey("phases.id", ondelete="CASCADE"))
    method: Mapped[str] = mapped_column(String(100))
    modality: Mapped[str] = mapped_column(String(8))
    source: Mapped[str] = mapped_column(String(300))
    kind: Mapped[str] = mapped_column(String(16), default="published", server_default=text("'published'"))
    note: Mapped[str] = mapped_column(String(600), default="", server_default=text("''"))
    percent_digits: Mapped[int] = mapped_column(default=2, server_default=text("2"))
    iou_occ: Mapped[float | None]
    iou_t: Mapped[float | None]
    iou_p: Mapped[float | None]
    iou_n: Mapped[float | None]
    miou: Mapped[float | None]
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)

    __table_args__ = (Index("uq_reported_phase_method", "phase_id", "method", "modality", unique=True),)


class PhaseInput(Base):
    """The sensor data of a phase's sequence, without any label, for participants to predict from.

    `name` is the sequence's; files lie in packs, as in an export.
    """

    __tablename__ = "phase_inputs"
    phase_id: Mapped[Id] = mapped_column(ForeignKey("phases.id", ondelete="CASCADE"), primary_key=True)
    name: Mapped[str] = mapped_column(String(100), primary_key=True)
    index_sha256: Mapped[str] = mapped_column(ForeignKey("blobs.sha256"), index=True)
    files: Mapped[int]
    size_bytes: Mapped[Bytes]
    tar_bytes: Mapped[Bytes]
    tar_sha256: Mapped[str] = mapped_column(String(64))
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)


class PhaseInputPack(Base):
    """A blob that contains files of an input, numbered as in its index."""

    __tablename__ = "phase_input_packs"
    phase_id: Mapped[Id] = mapped_column(ForeignKey("phases.id", ondelete="CASCADE"), primary_key=True)
    name: Mapped[str] = mapped_column(String(100), primary_key=True)
    ordinal: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    blob_sha256: Mapped[str] = mapped_column(ForeignKey("blobs.sha256"), index=True)
