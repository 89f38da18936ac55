# make install | develop | platform | baselines | demo | serve | test | test-all | test-kernels | test-baselines | stress | static | check | audit | docs | pictures | chaos | fuzz | bench | bench-eval | bench-label | bench-read | bench-datasets | bench-platform | bench-time-left | bench-pages | bench-truth | bench-outside | bench-confidence | bench-movers | bench-mounts | bench-real | bench-release | bench-faults | bench-decisions | bench-models | season | wheels | images
# Each installs first, which costs nothing when nothing changed.
.PHONY: install develop platform baselines test-baselines test-clients demo serve test test-all test-kernels stress style static check check-tests check-beside audit docs pictures chaos fuzz bench bench-eval bench-label bench-read bench-datasets bench-platform bench-time-left bench-pages bench-truth bench-outside bench-confidence bench-movers bench-mounts bench-real bench-release bench-faults bench-decisions bench-models season wheels images
.DELETE_ON_ERROR:
# Hundreds of processes are started: what one has compiled serves the others.
unexport PYTHONDONTWRITEBYTECODE

BIN := .venv/bin
# What the platform runs on; what tests, checks and benchmarks need besides; what the docs site is built with.
INSTALLED := .venv/.installed
DEVELOPED := .venv/.developed
DOCS_INSTALLED := .venv/.docs-installed
KERNELS_COMPILED := .venv/.kernels-compiled
STEPS := 6
BASELINES := .venv-baselines/.installed
BUILT := web/built/app.js
# The client's wheel, from where the platform serves it.
DOWNLOAD := api/downloads/.built
# The docs site, from where the platform serves it.
MANUAL := web/manual/index.html
DOCS := mkdocs.yml $(shell find docs docsite -type f -not -name '*.pyc')
CLIENT := $(shell find stone stone_base stone_files stone_submissions stone_exports stone_datasets stone_client deploy/client -name '*.py' -o -name '*.toml')
# One more than cores: tests wait for the servers that they start. Whole files, so that what a file makes is made once.
# A test that failed beside the others runs once more, alone (testing/reruns.py).
BESIDE = --rerun-failed-once --numprocesses $(shell n=$$(nproc); echo $$((n < 5 ? n + 1 : 6))) --dist loadfile --no-loadscope-reorder
# Tests that enter a kernel, and with every index checked: from a cache of their own, for numba takes what it finds there.
KERNELS := tests/stone/labels tests/stone/surface tests/stone/geometry/test_lattice.py tests/stone/geometry/test_se3.py \
	tests/stone/scoring/test_slow_metric.py tests/stone/sensors/test_deskew.py tests/stone/sensors/test_ground.py \
	tests/stone/test_kernels.py tests/stone_recordings/bags/test_messages_pointcloud2.py \
	tests/services/labeler/previews/test_render.py tests/services/labeler/test_hostile_values.py \
	tests/simulator/test_noise.py
MODULES := $(shell find web/modules web/libraries -name '*.ts' -o -name '*.js')

# What waits for nothing of each other is done at once. Kernels are compiled once, here: it takes a minute of a core.
install:
	@$(MAKE) --no-print-directory --silent --jobs=2 STEPS=3 $(INSTALLED) $(BUILT) $(KERNELS_COMPILED)

# With what the platform serves besides its pages: the client's wheel and the docs site.
platform:
	@$(MAKE) --no-print-directory --silent --jobs=3 $(INSTALLED) $(BUILT) $(KERNELS_COMPILED) $(DOWNLOAD) $(MANUAL)

$(INSTALLED): deploy/runtime.lock pyproject.toml deploy/client/pyproject.toml deploy/create-venv.sh deploy/install-system-libraries.sh
	@deploy/step.sh 1/$(STEPS) packages "Python packages of deploy/runtime.lock" deploy/create-venv.sh
	@touch $@

$(BUILT): $(MODULES) web/package-lock.json web/tsconfig.json deploy/build-pages.sh
	@deploy/step.sh 2/$(STEPS) pages "the pages' modules" deploy/build-pages.sh
	@touch $@

# Those that change afterwards are compiled where they are first called.
$(KERNELS_COMPILED): $(INSTALLED) deploy/warm_kernels.py
	@deploy/step.sh 3/$(STEPS) kernels "compiled kernels" $(BIN)/python deploy/warm_kernels.py
	@touch $@

$(DOWNLOAD): $(CLIENT) deploy/build-wheels.sh | $(INSTALLED)
	@deploy/step.sh 4/$(STEPS) client "the client's wheel" deploy/build-wheels.sh client
	@touch $@

$(DOCS_INSTALLED): $(INSTALLED) deploy/docs.lock
	@deploy/step.sh 5/$(STEPS) docs-packages "Python packages of the docs site: deploy/docs.lock" deploy/add-packages.sh --require-hashes -r deploy/docs.lock
	@touch $@

$(MANUAL): $(DOCS_INSTALLED) $(DOCS) deploy/build-docs.sh
	@deploy/step.sh 6/$(STEPS) docs "the docs site" deploy/build-docs.sh

develop: install $(DEVELOPED)

$(DEVELOPED): $(INSTALLED) requirements.lock
	@deploy/step.sh 1/1 develop "Python packages of tests and checks: requirements.lock" deploy/add-packages.sh --require-hashes -r requirements.lock
	@touch $@

test-clients: develop
	deploy/install-test-clients.sh
	deploy/install-devkit.sh
	deploy/install-browser.sh
	deploy/install-helm.sh

baselines: $(BASELINES)

$(BASELINES): $(DEVELOPED) baselines/requirements-cpu.txt deploy/create-baselines-venv.sh
	deploy/create-baselines-venv.sh
	touch $@

demo: platform
	$(BIN)/stone demo

serve: platform
	$(BIN)/stone serve

test: develop
	$(BIN)/pytest $(BESIDE) -m "not whole"

test-all: test-clients
	$(MAKE) --no-print-directory test-kernels
	$(BIN)/pytest $(BESIDE)

# In one process: beside each other several would compile the same kernels, which is most of what this costs.
test-kernels: develop
	NUMBA_BOUNDSCHECK=1 NUMBA_CACHE_DIR=$(CURDIR)/build/checked-kernels $(BIN)/pytest --rerun-failed-once -m "not release" $(KERNELS)

# What models need is in an environment of its own: the platform's tests run without torch.
# After `static` if both are made, for they share mypy's cache. In one process, for each loads torch.
test-baselines: baselines | $(filter static,$(MAKECMDGOALS))
	.venv-baselines/bin/python -m mypy -p baselines -p benchmarks.models -p stone_local.models -p stone_local.commands.models
	.venv-baselines/bin/python -m pytest --rerun-failed-once tests/baselines

# make stress TEST=<node id or file> runs it 50 times beside load; RUNS=10 for a slow one.
stress: develop
	$(BIN)/python -m testing.stress '$(TEST)' --runs $(or $(RUNS),50)

# Tests that wait leave cores idle, so the static checks and the kernels' tests run beside them, one after another.
check: test-clients style
	@rm -f build/flaky-tests
	$(MAKE) --no-print-directory --jobs=2 check-tests check-beside
	@if [ -f build/flaky-tests ]; then cat build/flaky-tests; fi

check-tests: develop
	$(BIN)/pytest $(BESIDE) -m "not release"

check-beside: develop
	$(MAKE) --no-print-directory --output-sync=target static test-kernels test-baselines

style: develop
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .

static: style
	$(BIN)/python -m testing.english
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/deptry stone stone_base stone_files stone_recordings stone_submissions stone_exports stone_datasets baselines services simulator stone_client stone_local api web
	$(BIN)/deptry --ignore DEP002,DEP004 benchmarks chaos deploy docsite fuzz testing tests

docs: install $(DOCS_INSTALLED)
	deploy/build-docs.sh

# The manual's pictures, from the folders of `make demo`; to be looked at before they are committed.
pictures: test-clients
	$(BIN)/python -m docsite.pictures demo stone-data
	$(BIN)/python -m docsite.robot_pictures

chaos: develop
	$(BIN)/python -m chaos
	$(BIN)/python -m chaos.seeds
	$(BIN)/python -m chaos.scoring
	$(BIN)/python -m chaos.restore
	$(BIN)/python -m chaos.restore --postgres --s3
	$(BIN)/python -m chaos.upgrade
	$(BIN)/python -m chaos.upgrade --postgres --kill
	$(BIN)/python -m chaos.machines || test $$? = 77  # no namespaces here: said, and skipped

audit: develop
	$(BIN)/python deploy/audit.py

fuzz: develop
	$(BIN)/python -m fuzz

bench-read: develop
	$(BIN)/python -m benchmarks.read

bench-datasets: develop
	$(BIN)/python -m benchmarks.datasets

bench: develop
	$(BIN)/python -m benchmarks.score

bench-eval: bench

bench-label: develop
	$(BIN)/python -m benchmarks.label

bench-platform: develop
	$(BIN)/python -m benchmarks.upload
	$(BIN)/python -m benchmarks.api
	$(BIN)/python -m benchmarks.platform_label
	$(BIN)/python -m benchmarks.sandbox

bench-time-left: develop
	$(BIN)/python -m benchmarks.time_left

bench-pages: test-clients
	$(BIN)/python -m benchmarks.pages
	$(BIN)/python -m benchmarks.viewer
	$(BIN)/python -m benchmarks.dashboard
	$(BIN)/python -m benchmarks.pages_upload

bench-truth: develop
	$(BIN)/python -m benchmarks.truth

# make bench-outside OPTIONS="--worlds hills --table"
bench-outside: develop
	$(BIN)/python -m benchmarks.outside $(OPTIONS)

bench-confidence: develop
	$(BIN)/python -m benchmarks.confidence

bench-movers: develop
	$(BIN)/python -m benchmarks.movers

# make bench-real FOLDER=... reads another folder than the tests' own.
bench-real: develop
	$(BIN)/python -m benchmarks.real $(FOLDER)

# make bench-release FOLDER=... compares our labels with the released ones in it, without FOLDER with a twin's.
bench-release: develop
	$(BIN)/python -m benchmarks.release $(FOLDER)

bench-faults: develop
	$(BIN)/python -m benchmarks.faults

bench-mounts: develop
	$(BIN)/python -m benchmarks.mounts

bench-models: baselines
	.venv-baselines/bin/python -m benchmarks.models.overfit
	.venv-baselines/bin/python -m benchmarks.models.unseen

bench-decisions: develop
	$(BIN)/python -m benchmarks.decisions

season: develop
	$(BIN)/python -m benchmarks.season

wheels: install
	$(MAKE) --no-print-directory $(MANUAL)
	deploy/build-wheels.sh

images:
	$(MAKE) --no-print-directory $(MANUAL)
	deploy/images/build.sh
