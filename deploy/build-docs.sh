#!/bin/sh
# Build the docs site into web/manual, from where the platform serves it below /docs/; it appears whole or not at all.
set -eu
cd "$(dirname "$0")/.."
rm -rf web/manual.partial
NO_MKDOCS_2_WARNING=1 .venv/bin/mkdocs build --quiet --site-dir web/manual.partial
rm -rf web/manual
mv web/manual.partial web/manual
