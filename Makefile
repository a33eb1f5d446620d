# Every command of the project. `make demo` and `make test` need Python >= 3.11, make and a package registry.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check

.PHONY: help demo test check format docs accuracy lock clean

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

check: $(VENV)/dev ## format, lint and types
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

format: $(VENV)/dev ## format the code
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

docs: $(VENV)/dev ## write what is made from the code: configs/example.yaml, docs/reference
	$(BIN)/python -m vtrack_batch.cli.reference

accuracy: $(VENV)/runtime ## measure against every truth at hand, write docs/accuracy.md
	$(BIN)/python benchmarks/accuracy.py

lock: ## resolve the lock files anew (needs uv)
	uv pip compile pyproject.toml --universal --generate-hashes --no-annotate --no-header --python-version 3.11 -o requirements.lock --upgrade
	uv pip compile pyproject.toml --group dev --universal --generate-hashes --no-annotate --no-header --python-version 3.11 -o requirements-dev.lock --upgrade

clean: ## remove what the other targets made
	rm -rf $(VENV) demo build *.egg-info .pytest_cache .mypy_cache .ruff_cache
