# make help   lists the targets

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
DEMO := runs/demo
# These worlds cover every part of every axis at least once; a test checks it.
PROVE_WORLDS := --plant mujoco --rigs 12 --seed 1500

.PHONY: help demo test kernels lint structure docs docs-run reference accuracy floor literal real bench prove prove-gas growth paper feedforward response pairs weight-check fault-matrix process-matrix moments realtime fuzz mutants long clean prove-worlds makes units console proofs durand one-model
.DEFAULT_GOAL := help

help:
	@grep -hE '^[a-z-]+:.*## ' Makefile | sed -E 's/^([a-z-]+):.*## /make \1\t/' | expand -t 22

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

$(VENV)/.docs: pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[docs]'
	@touch $@ $(VENV)/.runtime

docs: $(VENV)/.docs reference  ## build the documentation as a site (out/docs/index.html); warnings are errors
	$(BIN)/sphinx-build -q -b html -W --keep-going docs out/docs
	@! grep -rlE '<(script|link|img)[^>]+(src|href)="https?://' out/docs --include='*.html' \
	  || { echo "these pages load files from a network"; exit 1; }
	@echo "out/docs/index.html"

reference: $(VENV)/.runtime  ## write the reference pages (docs/reference) from the code
	$(BIN)/python docs/generator

docs-run: $(VENV)/.dev  ## run every code block of the documentation, the long ones too
	$(BIN)/python -m tests.long.docs_run

demo: $(VENV)/.runtime  ## run the Figure 10 sequence on the simulated bench and identify it (runs/demo/report.html)
	rm -rf $(DEMO)
	$(BIN)/rig run figure10 --yes --out $(DEMO)
	$(BIN)/rig identify $(DEMO) --method both

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

structure:  ## rooms, sizes and imports against their budgets
	$(PYTHON) tools/structure.py

# The kernels are compiled while the types are checked; the tests then need not wait for them.
kernels: $(VENV)/.dev
	@rm -rf out/kernels
	-@$(BIN)/rig run figure10 --yes --out out/kernels/run > /dev/null
	-@$(BIN)/rig identify out/kernels/run > /dev/null
	@rm -rf out/kernels

test: $(VENV)/.dev  ## lint, types, import directions, tests
	@$(MAKE) --no-print-directory -j2 lint kernels
	$(BIN)/pytest -n auto --dist worksteal -m "not proof"

proofs: $(VENV)/.dev  ## accuracy on whole benches and recordings, which make test leaves out; properties with new examples
	$(BIN)/pytest -n auto --dist worksteal -m proof
	HYPOTHESIS_PROFILE=random $(BIN)/pytest -n auto --dist worksteal -m "hypothesis and not proof"

long: $(VENV)/.runtime  ## time and memory of recordings from 1e4 to 3.6e7 samples
	$(BIN)/python benchmarks/long_recording.py
	$(BIN)/python benchmarks/long_recording.py --run

paper: $(VENV)/.runtime  ## the paper's figures and tables done again, 20 seeds (out/paper)
	$(BIN)/rig paper --out out/paper

accuracy: $(VENV)/.runtime  ## errors and interval coverage of the default method over 20 seeds of noise
	$(BIN)/python benchmarks/figure10_accuracy.py --seeds 20

floor: $(VENV)/.runtime  ## errors over the Cramer-Rao floor on 200 random benches; goes on where it was stopped (out/floor)
	$(BIN)/python benchmarks/floor.py --benches 200 --first 5000

literal: $(VENV)/.runtime  ## the literal bench, noise-free: the paper's constants and 20 random sets
	$(BIN)/python benchmarks/literal_accuracy.py

real: $(VENV)/.runtime  ## the real recordings: friction ladder, closed loop, screw drives, transfer, diagnoses (out/real)
	$(BIN)/python benchmarks/real_recordings.py
	$(BIN)/python benchmarks/real_diagnoses.py tests/campaigns/*.yaml

feedforward: $(VENV)/.runtime  ## tracking and energy before and after friction feed-forward, 8 seeds
	$(BIN)/python benchmarks/feedforward.py --seeds 8 --first 200

prove: $(VENV)/.dev  ## the blind proof of the diagnosis in ten minutes: a small set, and 12 worlds that cover every axis (out/proof, out/proof-worlds)
	$(BIN)/rig prove --rigs $(or $(RIGS),24) --jobs 2 --out out/proof
	$(BIN)/python -m benchmarks.worlds out/worlds $(PROVE_WORLDS) --jobs 2
	$(BIN)/rig prove --from out/worlds --jobs 2 --out out/proof-worlds

prove-gas: $(VENV)/.dev  ## the blind proof of the gas generator's diagnosis, 100 rigs (out/proof-gas)
	$(BIN)/python -m benchmarks.worlds out/worlds-gas --plant gas --rigs $(or $(RIGS),100) --jobs 2
	$(BIN)/rig prove --from out/worlds-gas --jobs 2 --out out/proof-gas

prove-worlds: $(VENV)/.dev  ## the blind proof in worlds on the project's machine, MuJoCo's and the tests' own, 60 rigs each; goes on where it was stopped (out/proof-*)
	for plant in own third mujoco; do \
	  $(BIN)/python -m benchmarks.worlds out/worlds-$$plant --plant $$plant --rigs $(or $(RIGS),60) --seed $(or $(SEED),1) --jobs 2 && \
	  $(BIN)/rig prove --from out/worlds-$$plant --jobs 2 --out out/proof-$$plant || exit 1; done

bench: $(VENV)/.runtime  ## speed, as ratios within one run
	for script in plant_speed identification_speed command_speed bus_speed transports; do $(BIN)/python benchmarks/$$script.py || exit 1; done

growth: $(VENV)/.runtime  ## how a diagnosis grows with samples and with the catalogue
	$(BIN)/python benchmarks/diagnosis_growth.py

weight-check: $(VENV)/.runtime  ## how often the weight check is right, on a stiff and a soft bench
	for bench in practical practical_soft; do $(BIN)/python -m tests.long.weight_check --bench $$bench || exit 1; done

response: $(VENV)/.dev  ## margins and proposed gains on 20 simulated benches against the linearised truth
	$(BIN)/python -m tests.long.response --seed $(or $(SEED),1)

pairs: $(VENV)/.dev  ## investigations of twelve pairs of effects that Figure 10 hardly tells apart (out/pairs.json)
	$(BIN)/python -m tests.long.pairs

fault-matrix: $(VENV)/.dev  ## every fault in every phase of a run on each transport (out/fault_matrix.md)
	$(BIN)/python -m tests.long.fault_matrix

makes: $(VENV)/.dev  ## drives of nine makes and three other modes: Figure 10; every fault in every phase, and in a homing
	$(BIN)/python -m tests.long.makes figure10
	$(BIN)/python -m tests.long.makes faults
	$(BIN)/python -m tests.long.makes homing

process-matrix: $(VENV)/.dev  ## adapter, line, terminal, disk or process fails in every phase (out/process_matrix.md)
	$(BIN)/python -m tests.long.process_matrix

moments: $(VENV)/.dev  ## 200 random moments each of what befalls run, guardian, adapter, terminal; a killed run is resumed
	$(BIN)/python -m tests.long.moments

units: $(VENV)/.dev  ## 100 benches with wrong units, signs, ratio or constant and 200 right ones: found by motion
	$(BIN)/python -m tests.long.units

one-model: $(VENV)/.dev  ## the errors that are printed are those of the exported model, on campaigns (CAMPAIGNS="a.yaml b.yaml")
	$(BIN)/python -m tests.long.one_model $(CAMPAIGNS)

durand: $(VENV)/.dev  ## check, commission and run against a drive on another CANopen stack: 1029h, slow SDO, lacking objects
	$(BIN)/python -m tests.long.durand_peer

realtime: $(VENV)/.dev  ## Figure 10 over slcan in real time, then identified; nothing else should run
	$(BIN)/python -m tests.long.realtime

console: $(VENV)/.dev  ## from STOP on the page to the drive read back off, and lateness with three pages
	$(BIN)/python benchmarks/console.py latency --presses $(or $(PRESSES),500)
	$(BIN)/python benchmarks/console.py latency --presses $(or $(PRESSES),500) --realtime
	$(BIN)/python benchmarks/console.py latency --presses $(or $(PRESSES),500) --wire slcan --wire socketcand --wire dbc --wire serial
	$(BIN)/python benchmarks/console.py lateness

fuzz: $(VENV)/.dev  ## a million frames or bytes for every decoder, a million EDS files, DBC files and maps; 150 000 random logs of each format
	$(BIN)/python -m tests.long.fuzz

mutants: $(VENV)/.dev  ## small changes of the safety modules, which their tests must notice; their branch coverage
	$(BIN)/python -m tests.long.mutants
	$(BIN)/pytest -q --cov-branch --cov-report=term-missing $$($(BIN)/python -m tests.long.mutants --coverage)

clean:  ## remove the virtual environment and everything generated
	rm -rf $(VENV) runs out build *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -prune -exec rm -rf {} +
