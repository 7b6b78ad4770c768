# Everything from nothing: `make demo` and `make test` need git, make and Python 3.11 or newer.
# The targets set up $(VENV) themselves, with the versions of constraints.txt, from wheels only: no compiler is asked for.

PYTHON ?= python3
VENV   ?= .venv

PY      := $(VENV)/bin/python
MILLCAL := $(PY) -m millcal
INSTALL := $(PY) -m pip install --quiet --no-input --disable-pip-version-check --only-binary :all: -c constraints.txt
RUNTIME := $(VENV)/.runtime-is-set-up
DEV     := $(VENV)/.dev-is-set-up

# Tests and recipes that need the reference recordings are skipped where this folder is not.
ifneq ($(wildcard ../shared/.),)
export MILLCAL_REFERENCE_DATA ?= $(abspath ../shared)
endif

# As the command does: the matrices are small and many, and threads cost more than they bring.
export OPENBLAS_NUM_THREADS ?= 1
export OMP_NUM_THREADS ?= 1

.PHONY: help demo recipes sample-data test test-long lint bench dist clean

help: ## show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-11s %s\n", $$1, $$2}' Makefile

# ---- set-up, redone only when pyproject.toml or constraints.txt change

$(RUNTIME): pyproject.toml constraints.txt
	@$(PY) -m pip --version >/dev/null 2>&1 || { $(NEW_VENV); }
	@echo "setting up $(VENV) with the packages of constraints.txt"
	@$(INSTALL) hatchling editables
	@$(INSTALL) --no-build-isolation --editable .
	@touch $@

$(DEV): $(RUNTIME)
	@echo "adding the packages for development"
	@$(INSTALL) --no-build-isolation --editable '.[dev]'
	@touch $@

# Debian's Python without python3-venv has the module venv but not ensurepip, and would leave half a folder behind.
define NEW_VENV
version=$$($(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null) || { \
  echo "error: $(PYTHON): does not run; sudo apt install python3 python3-venv, or make PYTHON=/path/to/python3" >&2; exit 1; }; \
$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
  echo "error: $(PYTHON): is Python $$version, millcal needs 3.11 or newer; make PYTHON=/path/to/a/newer/python3" >&2; exit 1; }; \
$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || { \
  echo "error: $(PYTHON): the package python3-venv is missing; sudo apt install python$$version-venv" >&2; exit 1; }; \
[ ! -e $(VENV) ] || [ -e $(VENV)/pyvenv.cfg ] || { \
  echo "error: $(VENV): exists and is no virtual environment; remove it, or make VENV=/another/folder" >&2; exit 1; }; \
$(PYTHON) -m venv --clear $(VENV) || { rm -rf $(VENV); \
  echo "error: $(VENV): cannot be made by $(PYTHON) -m venv; sudo apt install python$$version-venv" >&2; exit 1; }
endef

# ---- the main job

DEMO := slot-demo

demo: $(RUNTIME) ## set up, then fit the sample slot cuts; ends with the path of the report
	@$(MILLCAL) fit recipes/$(DEMO).toml --out build/$(DEMO) --depfile build/$(DEMO)/inputs.mk
	@echo "report: $(abspath build/$(DEMO)/report.html)"

# The last thing that a good run of `millcal fit --depfile` writes is inputs.mk: its time is the time of the result, its text
# the rule by which it depends on every file that was read. A recipe whose recordings are absent writes none, nor does one
# that fails; both are tried again. (Read by $(file) because make would remake an included file whatever it is asked for.)
RESULTS := $(patsubst recipes/%.toml,build/%/inputs.mk,$(wildcard recipes/*.toml))
SOURCES := $(shell find millcal -type f -not -path '*/__pycache__/*')

recipes: $(RESULTS) ## build/<recipe>/report.html of every recipe, where stale (make -j recipes)

$(RESULTS): build/%/inputs.mk: recipes/%.toml $(SOURCES) $(RUNTIME)
	@rm -f $@
	@$(MILLCAL) fit $< --out $(@D) --depfile $@ --quiet >/dev/null
	@if [ -e $@ ]; then echo "made $(@D)/report.html"; else echo "skipped $<: its recordings are not here"; fi

$(foreach rule,$(wildcard $(RESULTS)),$(eval $(file <$(rule))))

sample-data: $(RUNTIME) ## write the recordings of sample_data/ again from their recipes
	@set -e; for recipe in recipes/simulate/*.toml; do \
	  $(MILLCAL) simulate $$recipe --out sample_data/$$(basename $$recipe .toml) --quiet; done
	@$(PY) tests/generators/low_immersion_cuts.py >/dev/null
	@cd sample_data && LC_ALL=C sha256sum */* > SHA256SUMS

# ---- development

test: $(DEV) ## set up, then run the tests (ARGS: more arguments for pytest)
	@$(PY) -m pytest $(ARGS)

test-long: $(DEV) ## coverage studies over many seeds, fuzzing and kill tests at full length
	@$(PY) -m pytest -m long $(ARGS)

lint: $(DEV) ## ruff (rules and format) and mypy
	@$(PY) -m ruff check .
	@$(PY) -m ruff format --check .
	@$(PY) -m mypy

bench: $(DEV) ## measure against plain code and write docs/benchmarks.md (ARGS=--full: 1 GB of text)
	@$(PY) tests/bench $(ARGS)

dist: $(DEV) ## wheel and source archive in dist/
	@$(PY) -m build --no-isolation --outdir dist .

clean: ## remove build/, dist/ and caches, not the .venv
	@rm -rf build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
	@find millcal tests -name __pycache__ -type d -prune -exec rm -rf {} +
