# The image of the role `ingest`: recordings in, synchronised frames out.
ARG BASE=localhost/stone-base:local
ARG TOOLS=localhost/stone-tools:local
ARG WHEEL=localhost/stone-wheel:local

FROM ${WHEEL} AS wheel

FROM ${TOOLS} AS packages
COPY deploy/images/install-packages.sh deploy/images/ingest.lock /build/
RUN /build/install-packages.sh /build/ingest.lock
COPY pyproject.toml /build/
RUN /srv/tools/bin/cyclonedx-py environment --pyproject /build/pyproject.toml --output-reproducible \
        --output-file /sbom.json /srv/stone/bin/python

FROM ${BASE}
USER 0:0
COPY --from=packages /srv/stone /srv/stone
COPY --from=packages /sbom.json /sbom.json
RUN --mount=type=bind,from=wheel,source=/,target=/wheel \
    --mount=type=bind,from=packages,source=/srv/tools,target=/srv/tools \
    /srv/tools/bin/pip --python /srv/stone/bin/python install --no-cache-dir --no-deps --no-index --compile /wheel/*.whl
USER 10001:10001
ENV OMP_THREAD_LIMIT=1 \
    TMPDIR=/data/tmp
HEALTHCHECK --interval=30s --timeout=15s --start-period=150s --retries=3 CMD ["python", "-m", "services.runtime.processes.health_check"]
CMD ["python", "-m", "services.runtime.processes.worker", "ingest"]
ARG VERSION=0 REVISION=unknown
LABEL org.opencontainers.image.title="stone-ingest" \
      org.opencontainers.image.description="recordings in, synchronised frames out" \
      org.opencontainers.image.licenses="Apache-2.0" \
      org.opencontainers.image.version="${VERSION}" \
      org.opencontainers.image.revision="${REVISION}"
