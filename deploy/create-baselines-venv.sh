#!/bin/sh
# Create .venv-baselines: torch and the other packages of the models, on top of the platform's unchanged .venv.
#
# Its interpreter sees the packages of .venv too, so nothing is installed twice. From the project's root.
set -eu

[ -x .venv/bin/python ] || { echo "No .venv found: run make install first" >&2; exit 1; }
[ -x .venv-baselines/bin/python ] || .venv/bin/python -m venv --clear --without-pip .venv-baselines
base=$(.venv/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
own=$(.venv-baselines/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
echo "import site; site.addsitedir('$base')" > "$own/platform.pth"

if command -v uv >/dev/null; then
    uv pip install --quiet --python .venv-baselines/bin/python -r "${REQUIREMENTS:-baselines/requirements-cpu.txt}"
else
    [ -x .venv-baselines/bin/pip ] || .venv-baselines/bin/python -m ensurepip --default-pip >/dev/null
    .venv-baselines/bin/python -m pip install --quiet --disable-pip-version-check \
        -r "${REQUIREMENTS:-baselines/requirements-cpu.txt}"
fi
cat > .venv-baselines/bin/stone <<END
#!$PWD/.venv-baselines/bin/python
from stone_client.main import main
main()
END
chmod +x .venv-baselines/bin/stone
