# Caddy of Debian.
ARG PYTHON_IMAGE
FROM ${PYTHON_IMAGE}
ENV XDG_CONFIG_HOME=/config XDG_DATA_HOME=/data
# hadolint ignore=DL3008
RUN apt-get update && apt-get install --yes --no-install-recommends caddy wget && rm -rf /var/lib/apt/lists/* \
    && mkdir -p /config /data
WORKDIR /srv
CMD ["caddy", "run", "--config", "/etc/caddy/Caddyfile", "--adapter", "caddyfile"]
