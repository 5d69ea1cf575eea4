# Two commands are enough: `make demo` and `make test`. Each sets up .venv on its first run.

PYTHON ?= $(firstword $(foreach p,python3 python3.14 python3.13 python3.12 python3.11 python,\
            $(shell $(p) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $(p))))
VENV := .venv
MINUTES ?= 10
RUN := $(VENV)/bin/python -m

.PHONY: help demo test slow fuzz lint figure docs docs-serve dist clean

help:
	@echo "make demo    identify a simulated axis; the report is in ./ivtools-demo"
	@echo "make test    lint, types and tests (a few minutes)"
	@echo "make slow    the tests that take longer"
	@echo "make fuzz    malformed and pathological inputs, MINUTES=10"
	@echo "make figure  draw the figure of the README"
	@echo "make docs    build the documentation in ./site; make docs-serve shows it while you write"
	@echo "make dist    wheel and source archive in ./dist, checked"
	@echo "make clean   remove the environment and everything the commands wrote"

demo: $(VENV)/.installed
	$(VENV)/bin/ivtools demo

test: lint
	$(RUN) pytest -n 2 --dist loadfile -m "not slow"

slow: $(VENV)/.installed-dev
	$(RUN) pytest -n 2 --dist loadfile -m slow

lint: $(VENV)/.installed-dev
	$(RUN) ruff check .
	$(RUN) mypy

fuzz: $(VENV)/.installed-dev
	$(VENV)/bin/python tests/fuzz/fuzz.py --minutes $(MINUTES)

figure: $(VENV)/.installed
	$(VENV)/bin/python docs/figure.py

docs: $(VENV)/.installed-dev
	NO_MKDOCS_2_WARNING=1 $(RUN) mkdocs build --strict --quiet

docs-serve: $(VENV)/.installed-dev
	NO_MKDOCS_2_WARNING=1 $(RUN) mkdocs serve

dist: $(VENV)/.installed-dev
	rm -rf dist
	$(RUN) build --outdir dist .
	$(RUN) twine check --strict dist/*
	sha256sum dist/*
	@! grep -q '^address = ""' pyproject.toml || \
	  echo "no address of a repository in pyproject.toml: the README on an index is without links"

clean:
	rm -rf $(VENV) build dist site *.egg-info ivtools-demo ivtools-reproduce ivtools-report
	rm -rf .pytest_cache .mypy_cache .ruff_cache .hypothesis .benchmarks
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(VENV)/.installed: pyproject.toml | $(VENV)/bin/python
	$(RUN) pip install --quiet --editable .
	@touch $@

$(VENV)/.installed-dev: pyproject.toml | $(VENV)/bin/python
	$(RUN) pip install --quiet --editable ".[dev]"
	@touch $(VENV)/.installed $@

$(VENV)/bin/python:
	@test -n "$(PYTHON)" || { \
	  echo "ivtools needs Python 3.11 or newer; none was found (make PYTHON=/path/to/python names one)" >&2; \
	  exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "ivtools needs Python 3.11 or newer; $(PYTHON) is older or does not run" >&2; exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || { \
	  echo "$(PYTHON) cannot make virtual environments; on Debian and Ubuntu: apt install python3-venv" >&2; \
	  exit 1; }
	$(PYTHON) -m venv $(VENV)
