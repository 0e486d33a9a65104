# make demo   set up, run the Figure 10 bench on the simulated bus, identify it, write the report
# make test   set up, lint, types, import directions, tests
# make help   the rest

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
DEMO := runs/demo

.PHONY: help demo test lint accuracy floor literal bench paper clean
.DEFAULT_GOAL := help

help:
	@echo "make demo      run the Figure 10 sequence on the simulated bench and identify it ($(DEMO)/report.html)"
	@echo "make test      lint, types, import directions, tests"
	@echo "make paper     the paper's tables and Fig. 12 and 13, 20 seeds (out/paper)"
	@echo "make accuracy  errors and interval coverage of the default method over 20 seeds of noise"
	@echo "make floor     errors over the Cramer-Rao floor on 200 random benches; goes on where it was stopped (out/floor)"
	@echo "make literal   the literal bench, noise-free: the paper's constants and 20 random sets"
	@echo "make bench     speed, as ratios within one run"
	@echo "make clean     remove the virtual environment and everything generated"

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "loadrig needs Python 3.11 or newer; $(PYTHON) is older. Try: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 1; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.runtime: pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e .
	@touch $@

$(VENV)/.dev: pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]'
	@touch $@ $(VENV)/.runtime

demo: $(VENV)/.runtime
	rm -rf $(DEMO)
	$(BIN)/rig run figure10 --yes --out $(DEMO)
	$(BIN)/rig identify $(DEMO) --method both

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

test: lint
	$(BIN)/pytest

paper: $(VENV)/.runtime
	$(BIN)/rig paper --out out/paper

accuracy: $(VENV)/.runtime
	$(BIN)/python benchmarks/figure10_accuracy.py --seeds 20

floor: $(VENV)/.runtime
	$(BIN)/python benchmarks/floor.py --benches 200 --first 5000

literal: $(VENV)/.runtime
	$(BIN)/python benchmarks/literal_accuracy.py

bench: $(VENV)/.runtime
	for script in plant_speed identification_speed bus_speed; do $(BIN)/python benchmarks/$$script.py || exit 1; done

clean:
	rm -rf $(VENV) runs out build *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -prune -exec rm -rf {} +
