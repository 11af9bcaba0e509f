# Two commands do everything on a fresh machine: `make demo` and `make test`. `make help` lists the rest.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
PIP    := $(BIN)/python -m pip --quiet --disable-pip-version-check

.DEFAULT_GOAL := help
.PHONY: help demo check corpus test nightly system vm lint audit mutants bench build kit docs figures site release setup dev lock wheelhouse clean

help:  ## this list
	@sed -n 's/^\([a-z]*\):.*##/make \1\t/p' $(MAKEFILE_LIST) | expand -t 18

demo: setup  ## an emulated rig, the daemon, an unknown object: live estimates until Ctrl-C
	@$(BIN)/palmd demo $(DEMO_ARGS)

test: dev  ## all tests, linters, types and import contracts
	@$(BIN)/palmd doctor build --all
	@$(BIN)/python tools/run_tests.py

nightly: dev  ## slow campaigns with fresh seeds, some hours: studies, faults, soak; into build/nightly
	@nice $(BIN)/python tools/nightly.py build/nightly $(NIGHTLY)

check: dev  ## the inner loop: linters, types, unit tests of what changed, a sample of the corpus
	@$(BIN)/python tools/check.py

corpus: dev  ## what estimate and reconstruct make of stored logs, compared with frozen results
	@$(BIN)/python tests/corpus/corpus.py check

system: dev  ## only the services, under a systemd of their own (skipped unless root may boot one)
	$(BIN)/python -m pytest -q -m system

vm: dev  ## a rig PC in QEMU, with a real-time kernel, ports, plugs and power that fails: an hour, as root
	$(BIN)/python -m pytest -q -s -m vm tests/vm

lint: dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

mutants: dev  ## small faults put into what must not fail: do the tests notice? hours; MUTANTS="--sample 20 --seed 1"
	$(BIN)/python tools/mutants.py $(MUTANTS)

audit: dev  ## known holes in what is locked, as far as PyPI answers
	$(BIN)/python tools/audit.py requirements.lock requirements-dev.lock

bench: dev  ## lateness, work and step times as p50/p99/p99.9/max (needs an idle machine)
	$(BIN)/python -m pytest -q -s -m bench tests/bench

kit: setup  ## everything to build the tabletop rig, checked, in build/kit; KIT="--set strip_length=73.7" for another size
	@$(BIN)/python -m tools.tabletop $(KIT)

docs: dev  ## the pages that are generated from the code's tables
	$(BIN)/python tools/make_docs.py

figures: dev  ## pictures and figures of README and docs again, with seed and date in docs/figures/made.csv; FIGURES="montecarlo explore" for those that last
	$(BIN)/python -m tools.figures $(FIGURES)

site: dev docs  ## the documentation as a site that reads without a network, in build/site (warnings are errors)
	@NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet
	@echo "build/site/index.html"

release: dev docs  ## dist/: wheel, source archive, site, upgrade notes, checksums, container image where a builder is; the wheel is tried
	$(BIN)/python -m tools.release --check

build: setup  ## compile the observers' C once (takes a C compiler: sudo apt-get install gcc libc6-dev)
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

wheelhouse: setup  ## everything needed to install on a machine without network, in wheelhouse/
	$(PIP) download --require-hashes -r requirements.lock -d wheelhouse
	$(PIP) wheel --no-deps --no-build-isolation -w wheelhouse .

clean:  ## remove the environment and all caches
	rm -rf $(VENV) build dist wheelhouse .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
