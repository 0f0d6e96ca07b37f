# Four commands, each with all of its own set-up:
#   make demo   the whole pipeline at smoke scale, ending with the report
#   make test   linters, types and the whole test suite
#   make docs   the documents as a site
#   make bench  how fast world, learners, planners and the search's store are on this machine
# A Python 3.11 or newer is looked for; PYTHON=/path/to/python3 chooses one. make clean removes what they install.

VENV := .venv
BIN := $(VENV)/bin
PYTHON ?= $(shell for python in python3.11 python3 python3.12 python3.13; do \
	$$python -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$python && break; done)
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet
WORKERS ?= 2

export MPLBACKEND := Agg
unexport PYTHONDONTWRITEBYTECODE  # every process would compile torch's sources anew: ten seconds each
test: export OMP_NUM_THREADS := 1

.PHONY: demo test bench docs install clean
.DEFAULT_GOAL := install

install: $(VENV)/installed

demo: $(VENV)/installed
	$(BIN)/formctl reproduce profile=smoke

test: $(VENV)/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder

docs: $(VENV)/installed-dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	@echo "site: build/site/index.html"

bench: $(VENV)/installed-dev
	$(BIN)/formctl bench
	$(BIN)/python -m tests.benchmarks.world --compiled
	$(BIN)/python -m tests.benchmarks.learners
	$(BIN)/python -m tests.benchmarks.planners
	$(BIN)/python -m tests.benchmarks.store

$(VENV)/created:
	@test -n "$(PYTHON)" || { echo "formctl needs Python 3.11 or newer with its venv module; none was found." \
		"Install one, or name it: make PYTHON=/path/to/python3 $(MAKECMDGOALS)" >&2; exit 2; }
	"$(PYTHON)" -m venv --clear $(VENV)
	$(PIP) install --upgrade pip
	@touch $@

$(VENV)/installed: pyproject.toml $(VENV)/created
	@echo "Installing formctl into $(VENV): about 1.7 GB, a few minutes the first time."
	$(PIP) install --no-compile --editable .
	@echo "Installed. To compile now what trainings need, once: $(BIN)/formctl doctor --warm"
	@touch $@

$(VENV)/installed-dev: pyproject.toml $(VENV)/installed
	$(PIP) install --no-compile --editable ".[dev]"
	@touch $@

clean:
	rm -rf $(VENV) build dist .pytest_cache .mypy_cache .ruff_cache
