#!/bin/sh
# Run uv: uv.sh ARGUMENTS…, from the project's root. 127: it cannot be had here, or pip is told what uv cannot be.
#
# The uv on PATH, else the release of deploy/uv.lock in build/uv: pip fetches it from pip's own index and checks its hash;
# then it is told of the index and the certificates that pip is told of.
set -eu

if command -v uv >/dev/null; then
    exec uv "$@"
fi
folder=$PWD/build/uv
if [ ! -x "$folder/bin/uv" ] || [ deploy/uv.lock -nt "$folder/bin/uv" ]; then
    rm -rf "$folder"
    if ! { .venv/bin/python -m venv "$folder" &&
        "$folder/bin/pip" install --disable-pip-version-check --only-binary :all: --require-hashes -r deploy/uv.lock &&
        touch "$folder/bin/uv"; } >&2; then
        rm -rf "$folder"
        echo "uv was not fetched: pip does its work" >&2
        exit 127
    fi
fi
settings=$("$folder/bin/pip" config list)
if echo "$settings" | grep -Eq "\.(no-index|proxy|client-cert|trusted-host)="; then
    echo "pip's settings are none that uv knows: pip does its work" >&2
    exit 127
fi

# What pip is told: the environment stands first, before its files.
setting() {
    echo "$settings" | sed -n "s/^[^ ]*\.$1='\(.*\)'\$/\1/p" | head -n 1
}
index=$(setting 'index.url')
certificates=$(setting cert)
if [ -n "$index" ]; then
    export UV_DEFAULT_INDEX="${UV_DEFAULT_INDEX:-$index}"
fi
if [ -n "$certificates" ]; then
    export SSL_CERT_FILE="${SSL_CERT_FILE:-$certificates}"
fi
exec "$folder/bin/uv" "$@"
