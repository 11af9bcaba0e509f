# On a fresh machine, `make demo` and `make test` install what they need. `make help` lists all targets.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
PIP    := $(BIN)/python -m pip --quiet --disable-pip-version-check

.DEFAULT_GOAL := help
.PHONY: help demo check corpus test nightly system vm lint audit mutants bench build kit docs figures site release setup dev lock wheelhouse clean

help:  ## print this list
	@sed -n 's/^\([a-z]*\):.*##/make \1\t/p' $(MAKEFILE_LIST) | expand -t 18

demo: setup  ## run an emulated rig and the daemon on an unknown object, until Ctrl-C
	@$(BIN)/palmd demo $(DEMO_ARGS)

test: dev  ## run all tests, linters, type checks and import contracts
	@$(BIN)/palmd doctor build --all
	@$(BIN)/python tools/run_tests.py

nightly: dev  ## run slow campaigns with new seeds (some hours): studies, faults, soak; output in build/nightly
	@nice $(BIN)/python tools/nightly.py build/nightly $(NIGHTLY)

check: dev  ## quick check: linters, types, unit tests of changed modules, a sample of the corpus
	@$(BIN)/python tools/check.py

corpus: dev  ## compare results of estimate and reconstruct on stored logs with frozen ones
	@$(BIN)/python tests/corpus/corpus.py check

system: dev  ## test only the services, under a separate systemd (skipped without root)
	$(BIN)/python -m pytest -q -m system

vm: dev  ## test a rig PC in QEMU with real-time kernel, unplugged ports and power failures (an hour, as root)
	$(BIN)/python -m pytest -q -s -m vm tests/vm

lint: dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

mutants: dev  ## mutation tests of the critical modules (hours); MUTANTS="--sample 20 --seed 1"
	$(BIN)/python tools/mutants.py $(MUTANTS)

audit: dev  ## check the locked packages for known vulnerabilities (needs PyPI)
	$(BIN)/python tools/audit.py requirements.lock requirements-dev.lock

bench: dev  ## measure lateness, work and step times as p50/p99/p99.9/max (needs an idle machine)
	$(BIN)/python -m pytest -q -s -m bench tests/bench

kit: setup  ## write and check all files for building the tabletop rig, in build/kit; KIT="--set strip_length=73.7" for another size
	@$(BIN)/python -m tools.tabletop $(KIT)

docs: dev  ## regenerate the pages that are made from tables in the code
	$(BIN)/python tools/make_docs.py

figures: dev  ## regenerate pictures and figures, with seed and date in docs/figures/made.csv; FIGURES="montecarlo explore" for the slow ones
	$(BIN)/python -m tools.figures $(FIGURES)

site: dev docs  ## build the documentation site for offline use, in build/site (warnings are errors)
	@NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet
	@echo "build/site/index.html"

release: dev docs  ## build and test dist/: wheel, source archive, site, upgrade notes, checksums, container image if there is a builder
	$(BIN)/python -m tools.release --check

build: setup  ## compile the observers' C code (needs a C compiler: sudo apt-get install gcc libc6-dev)
	@$(BIN)/palmd doctor build

setup: $(VENV)/.run-installed
dev: $(VENV)/.dev-installed

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "palmd needs Python 3.11 or newer; $(PYTHON) is $$($(PYTHON) -V 2>&1). Debian 12: sudo apt-get install python3"; exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || \
	  { echo "the venv module is missing: sudo apt-get install python3-venv"; exit 1; }
	@echo "creating $(VENV)…"
	@$(PYTHON) -m venv $(VENV)

$(VENV)/.run-installed: requirements.lock pyproject.toml | $(VENV)/bin/python
	@echo "installing palmd (some 180 MB the first time)…"
	@$(PIP) install --require-hashes -r requirements.lock
	@$(PIP) install --no-deps --no-build-isolation -e .
	@touch $@

$(VENV)/.dev-installed: requirements-dev.lock $(VENV)/.run-installed
	@echo "installing the test tools…"
	@$(PIP) install --require-hashes -r requirements-dev.lock
	@touch $@

lock: $(VENV)/bin/python  ## renew both lock files (needs uv)
	uv pip compile -q pyproject.toml --extra build --extra report --universal --python-version 3.11 --generate-hashes --no-header -o requirements.lock
	uv pip compile -q pyproject.toml --extra build --extra report --extra dev --universal --python-version 3.11 --generate-hashes --no-header -o requirements-dev.lock

wheelhouse: setup  ## download all packages for installation on a machine without network, in wheelhouse/
	$(PIP) download --require-hashes -r requirements.lock -d wheelhouse
	$(PIP) wheel --no-deps --no-build-isolation -w wheelhouse .

clean:  ## remove the environment and all caches
	rm -rf $(VENV) build dist wheelhouse .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
