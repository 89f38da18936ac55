# The image of the role `api`: REST API and pages; also the sweeper and what prepares a release.
ARG BASE=localhost/stone-base:local
ARG TOOLS=localhost/stone-tools:local
ARG WHEEL=localhost/stone-wheel:local

FROM ${WHEEL} AS wheel

FROM ${TOOLS} AS packages
COPY deploy/images/install-packages.sh deploy/images/api.lock /build/
RUN /build/install-packages.sh /build/api.lock
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
ENV STONE_API__HOST=0.0.0.0
EXPOSE 8080
HEALTHCHECK --interval=30s --timeout=15s --start-period=150s --retries=3 CMD ["python", "-m", "services.runtime.processes.health_check", "http://127.0.0.1:8080/readyz"]
CMD ["python", "-m", "services.runtime.processes.api"]
ARG VERSION=0 REVISION=unknown
LABEL org.opencontainers.image.title="stone-api" \
      org.opencontainers.image.description="REST API and pages; also the sweeper and what prepares a release" \
      org.opencontainers.image.licenses="Apache-2.0" \
      org.opencontainers.image.version="${VERSION}" \
      org.opencontainers.image.revision="${REVISION}"
