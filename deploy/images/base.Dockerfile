# Three targets: `base`, on which every image stands; `tools`, with which they are built; `wheel`, the project itself and its client.
# deploy/images/build.sh builds them first. The wheel is an image of its own so that a release with the same locks
# leaves every layer of packages as it is.
ARG PYTHON_IMAGE=python:3.11.14-slim-bookworm

FROM ${PYTHON_IMAGE} AS base
ENV HOME=/tmp \
    LANG=C.UTF-8 \
    MPLCONFIGDIR=/tmp/matplotlib \
    NUMBA_CACHE_DIR=/data/numba \
    PATH=/srv/stone/bin:/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin \
    PYTHONDONTWRITEBYTECODE=1 \
    PYTHONSAFEPATH=1 \
    PYTHONUNBUFFERED=1 \
    STONE_DATA_FOLDER=/data
RUN groupadd --gid 10001 stone \
    && useradd --uid 10001 --gid 10001 --no-create-home --home-dir /tmp --shell /usr/sbin/nologin stone \
    && install --directory --owner=stone --group=stone --mode=0750 /data /data/uploads
WORKDIR /data
STOPSIGNAL SIGTERM
USER 10001:10001

FROM base AS tools
# Building is root's; only `base` is run.
# hadolint ignore=DL3002
USER 0:0
COPY deploy/images/build.lock /build/build.lock
RUN python3 -m venv /srv/tools \
    && /srv/tools/bin/pip install --no-cache-dir --require-hashes --requirement /build/build.lock

FROM tools AS wheel-build
WORKDIR /build/project
COPY deploy/node.lock deploy/build-pages.sh deploy/find-python.sh deploy/
COPY web/package.json web/package-lock.json web/tsconfig.json web/
COPY web/libraries web/libraries
COPY web/modules web/modules
RUN deploy/build-pages.sh
COPY . .
WORKDIR /build/project/deploy/client
RUN /srv/tools/bin/python -m hatchling build -t wheel -d /wheel
# The platform serves its client's wheel, so that comes first.
WORKDIR /build/project
RUN install -D --target-directory=api/downloads /wheel/stone_client-*.whl \
    && /srv/tools/bin/python -m hatchling build -t wheel -d /wheel

FROM scratch AS wheel
COPY --from=wheel-build /wheel /
