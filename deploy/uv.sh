#!/bin/sh
# Run uv: uv.sh ARGUMENTS…, from the project's root. Exit with 127 if uv is unavailable or cannot use pip's settings.
#
# Use the uv on PATH, or the release of deploy/uv.lock in build/uv, which pip downloads from its own index with a hash
# check. uv gets pip's index and certificates.
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
        echo "uv could not be installed: using pip" >&2
        exit 127
    fi
fi
settings=$("$folder/bin/pip" config list)
if echo "$settings" | grep -Eq "\.(no-index|proxy|client-cert|trusted-host)="; then
    echo "uv does not support pip's settings: using pip" >&2
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
