# make install | demo | serve | test | check | bench | bench-truth: each installs first, which costs nothing when nothing changed.
.PHONY: install demo serve test check bench bench-truth
.DELETE_ON_ERROR:

BIN := .venv/bin
INSTALLED := .venv/.installed

install: $(INSTALLED)

$(INSTALLED): requirements.lock pyproject.toml deploy/create-venv.sh deploy/install-system-libraries.sh
	deploy/create-venv.sh
	touch $@

demo: install
	$(BIN)/stone demo

serve: install
	$(BIN)/stone serve

test: install
	$(BIN)/pytest --numprocesses auto --maxprocesses 4 --dist loadscope

check: install
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/pytest --numprocesses auto --maxprocesses 4 --dist loadscope

bench: install
	$(BIN)/python -m benchmarks.label
	$(BIN)/python -m benchmarks.score

bench-truth: install
	$(BIN)/python -m benchmarks.truth
