# make run | make test | make thorough | make docs | make benchmark | make peers | make mutants | make soak | make study | make setup | make lint | make lock | make clean
# Needs Python 3.11 or later with venv and pip, git, make and gcc; choose the Python with PYTHON=python3.12.

SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DELETE_ON_ERROR:
# The tests start hundreds of Pythons, each of which would compile every library again.
unexport PYTHONDONTWRITEBYTECODE

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install -qq --disable-pip-version-check
# No command imports these modules, or few of them.
NOT_IMPORTED := /(tests?|pip|setuptools|pkg_resources|mypy|mypyc|sqlalchemy|alembic|fontTools|lexers|physics)/
STAMP := $(VENV)/.installed
SITE := $(VENV)/.installed-docs
WORKERS ?= 2
FAST := ur10_fast ur10_fast_kinematic ur10_fast_tuned
SLOW := ur10_slow ur10_slow_kinematic ur10_slow_tuned
SOURCES := dmframe blocks plants tests

.PHONY: run test thorough docs mutants soak study setup lint style lock clean benchmark peers

# The paper's two experiments: a table and a folder of figures each.
run: setup
	$(BIN)/dmframe run $(FAST)
	$(BIN)/dmframe run $(SLOW)

# mypy takes half a minute of one core where it has no cache; it is done long before the tests are.
test: style
	$(BIN)/mypy & types=$$!; status=0; \
	$(BIN)/python -m pytest -n $(WORKERS) --dist worksteal || status=$$?; wait $$types; exit $$status

# The tests that take long: those of tests/thorough.txt, which says what `make test` shows of them.
thorough: setup
	$(BIN)/python -m pytest -n $(WORKERS) --dist worksteal -m thorough

# Every fault that can be seeded into a block, a certificate or a shared function, each in the cheapest closed loop in
# which it changes something: an hour of computing. MUTANTS=--everywhere puts it into all loops; MUTANTS="--results FILE"
# keeps the results, with which a run that was stopped goes on.
mutants: setup
	$(BIN)/python tests/framework/certify/mutants.py $(MUTANTS)

# How long the packaged graphs stay sound beyond their own durations, over a simulated day: half an hour.
soak: setup
	$(BIN)/python tests/soak.py

# A study of 100 000 runs on two dask workers, one of which is killed, as is the client: complete, nothing twice, equal to
# the undisturbed one. STUDY="--runs 4000" makes it shorter.
study: setup
	$(BIN)/python tests/study_killed.py $(STUDY)

lint: style
	$(BIN)/mypy

style: setup
	$(BIN)/ruff check $(SOURCES)
	$(BIN)/ruff format --check $(SOURCES)
	$(BIN)/lint-imports
	$(BIN)/python tests/words.py

setup: $(STAMP)

# An older pip takes twice as long to find what is locked. Bytecode is compiled here, on all cores: without it, as where
# PYTHONDONTWRITEBYTECODE is set, each command takes longer. MuJoCo is for tests/in_mujoco alone and has no wheel on some
# platforms; it is the one package of the tests that is not locked.
$(STAMP): pyproject.toml requirements.lock
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "dmframe needs Python 3.11 or later, found $$($(PYTHON) --version 2>&1); name another: make PYTHON=python3.12" >&2; \
	  exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(PIP) --no-compile --upgrade "pip>=25.1"
	$(PIP) --no-compile --require-hashes -r requirements.lock
	$(PIP) --no-deps --no-build-isolation --editable .
	$(PIP) --no-compile --only-binary :all: --group mujoco || echo "no wheel of MuJoCo: tests/in_mujoco is skipped" >&2
	$(BIN)/python -m compileall -qq -j 0 -x '$(NOT_IMPORTED)' $(VENV) dmframe blocks plants || true
	touch $@

# uv is needed for this alone: the lock serves every Python and platform, and names no registry.
lock:
	uv pip compile --quiet --universal --generate-hashes --python-version 3.11 --no-emit-index-url \
	  --no-emit-find-links --custom-compile-command "make lock" --group dev pyproject.toml -o requirements.lock

# How long certificates take, with SymPy for comparison; then dmframe beside other tools, where they are installed: half
# an hour. BENCHMARK="a --seconds 20" runs one part of the second, BENCHMARK=--check compares it with its baseline.
benchmark: setup
	$(BIN)/python tests/benchmarks/certify.py
	$(BIN)/python -m tests.benchmarks $(BENCHMARK)

# The site, as plain files that need no server and no network: build/docs/index.html. Every warning stops it. What it needs
# beside the project, some 100 megabytes, is installed the first time.
docs: $(SITE)
	$(BIN)/python docs/make_site.py

$(SITE): pyproject.toml $(STAMP)
	$(PIP) --group docs
	touch $@

# The other tools: some hundred megabytes.
peers: setup
	$(PIP) --group peers

clean:
	rm -rf $(VENV) build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
