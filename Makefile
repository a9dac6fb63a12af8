# `make demo` and `make test` make the virtual environment themselves.
PYTHON ?= $(firstword $(foreach v,3.11 3.12 3.13,$(shell command -v python$(v) >/dev/null 2>&1 && python$(v) -c 'import venv' 2>/dev/null && echo python$(v))) python3)
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
TESTED := $(VENV)/.installed-test
OUT ?= demo

.PHONY: help demo test test-all lint docs bench models env env-test clean system

help:
	@echo "make demo      plan a scan of the built-in carving into $(OUT)/"
	@echo "make test      the test suite        make test-all  with the slow tests"
	@echo "make lint      ruff and pyright      make bench     the benchmarks"
	@echo "make docs      the site of the documents"

# Before anything is downloaded: Python's version and the libraries of the system.
system:
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' || \
	  { echo "scanmotion needs Python 3.11, 3.12 or 3.13; $(PYTHON) is $$($(PYTHON) -V 2>&1). Try: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 2; }
	@$(PYTHON) models/check_system.py

$(STAMP): pyproject.toml constraints.txt | system
	@echo "making $(VENV) and installing scanmotion into it: some minutes, some 2.2 GB"
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install -q --disable-pip-version-check -c constraints.txt -e .
	@touch $@

$(TESTED): $(STAMP)
	@echo "installing what the tests need besides"
	$(BIN)/python -m pip install -q --disable-pip-version-check -c constraints.txt -e '.[test]'
	@touch $@

env: system $(STAMP)

env-test: env $(TESTED)

demo: env
	$(BIN)/scanmotion plan --robot kr240 --out $(OUT)
	@echo "scene:  $(OUT)/scene.html"
	@echo "report: $(OUT)/report.html"

test: env-test
	$(BIN)/python -m pytest -n auto --dist loadfile

test-all: env-test
	$(BIN)/python -m pytest -n auto --dist loadfile -m ''

lint: env-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

docs: env-test
	$(BIN)/python -m sphinx -q -W --keep-going -b html docs docs/_build
	@echo "docs:   docs/_build/index.html"

bench: env-test
	@for b in benchmarks/*.py; do echo "== $$b"; $(BIN)/python $$b || exit 1; done

clean:
	rm -rf $(VENV) $(OUT) .pytest_cache .ruff_cache .hypothesis
