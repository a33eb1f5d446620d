# Every command of the project. `make demo` and `make test` need Python >= 3.11, make and a package registry.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check

.PHONY: help demo test test-slow check format docs lock clean \
        accuracy bench-matching bench-tracks bench-paper bench-seeing bench-ablation bench-speed bench-oracles bench-scale bench-faults bench-archive bench-engine bench-zoo \
        train-matching

help: ## list the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/'

$(VENV)/made:
	$(PYTHON) -m venv $(VENV)
	@touch $@

$(VENV)/runtime: requirements.lock pyproject.toml | $(VENV)/made
	$(INSTALL) --require-hashes -r requirements.lock
	$(INSTALL) --no-deps --editable .
	@touch $@

$(VENV)/dev: requirements-dev.lock $(VENV)/runtime
	$(INSTALL) --require-hashes -r requirements-dev.lock
	@touch $@

demo: $(VENV)/runtime ## make a small archive with known truth, run it, print truth beside result
	rm -rf demo
	$(BIN)/vtrack-batch simulate configs/scenario-crossing.yaml demo --workers 2
	$(BIN)/vtrack-batch run demo/survey.yaml --workers 2 -v
	$(BIN)/vtrack-batch evaluate demo/results demo/truth
	@echo "tables: demo/results/current/<table>   report: demo/results/current/report/report.html"

test: $(VENV)/dev ## run the whole test suite
	$(BIN)/python -m pytest -n 2

test-slow: $(VENV)/dev ## run the tests that take minutes
	$(BIN)/python -m pytest -m slow --timeout 3000

check: $(VENV)/dev ## format, lint and types
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

format: $(VENV)/dev ## format the code
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

docs: $(VENV)/dev ## write what is made from the code: configs/example.yaml, docs/reference
	$(BIN)/python -m vtrack_batch.cli.reference

accuracy: $(VENV)/runtime ## measure whole runs against every truth at hand: docs/accuracy.md
	$(BIN)/python -m benchmarks.accuracy

# Benchmarks make the environments of peers under build/peers. QUICK=1 takes the first few of everything.
bench-matching: $(VENV)/runtime ## our matching and peers on pinned pairs: docs/accuracy.md
	QUICK=$(QUICK) OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.matching

bench-tracks: $(VENV)/runtime ## our tracking and peers on sequences and real traffic: docs/accuracy.md
	QUICK=$(QUICK) OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.tracks

bench-paper: $(VENV)/runtime ## the paper's Tables 1-3 and its sweep: docs/paper.md
	QUICK=$(QUICK) OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.paper

bench-seeing: $(VENV)/runtime ## detection, registration, rendered frames, beside peers and real ones: docs/accuracy.md
	QUICK=$(QUICK) OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.seeing

bench-ablation: $(VENV)/runtime ## what each part of seeing is worth: docs/accuracy.md
	QUICK=$(QUICK) OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.ablation

bench-speed: $(VENV)/runtime ## a run in units of decoding, stage by stage: docs/performance.md
	QUICK=$(QUICK) OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.speed

bench-oracles: $(VENV)/runtime ## our IDF1, MOTA, HOTA and links beside TrackEval, motmetrics and TrackMate
	$(BIN)/python -m benchmarks.oracles
	$(BIN)/python -m benchmarks.trackmate

bench-scale: $(VENV)/runtime ## how matching and tracking scale with vehicles and frames: docs/performance.md
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.scale_matching

bench-faults: $(VENV)/dev ## make every change of the disk fail, and kill at random, 200 times
	$(BIN)/python -m benchmarks.faults --kills 200

bench-archive: $(VENV)/runtime ## how the engine scales with frames: docs/performance.md
	$(BIN)/python -m benchmarks.scale_archive 100000 1000000

bench-engine: $(VENV)/dev ## publishing years, the engine's share, workers, a unit on Dask: docs/performance.md
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.engine

bench-zoo: $(VENV)/dev ## outcome, time and memory of every broken file: docs/reliability.md
	$(BIN)/python -m benchmarks.zoo

train-matching: $(VENV)/dev ## train the learned link score anew on simulated traffic, write it into the package
	$(BIN)/python -m benchmarks.train_matching

lock: ## resolve the lock files anew (needs uv)
	uv pip compile pyproject.toml --extra sim --universal --generate-hashes --no-annotate --no-header --python-version 3.11 -o requirements.lock --upgrade
	uv pip compile pyproject.toml --all-extras --group dev --universal --generate-hashes --no-annotate --no-header --python-version 3.11 -o requirements-dev.lock --upgrade

clean: ## remove what the other targets made
	rm -rf $(VENV) demo build *.egg-info .pytest_cache .mypy_cache .ruff_cache
	find vtrack_batch benchmarks tests -name __pycache__ -prune -exec rm -rf {} +
