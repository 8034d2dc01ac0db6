# Everything happens in .venv, which the first target that needs it makes. `make help` lists the targets.

VENV := .venv
PUDDLE := $(VENV)/bin/puddle
READY := $(VENV)/.ready
PRESET ?= laptop
MINUTES ?= 60
TORCH_INDEX ?=

# The first Python that runs and is one of 3.11 to 3.13; override with `make PYTHON=...`.
PYTHON ?= $(firstword $(foreach p,python3 python3.13 python3.12 python3.11,$(shell \
	$(p) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] < (3, 14))' 2>/dev/null && echo $(p))))

.DEFAULT_GOAL := help
.PHONY: help setup study test torture lint ui bench clean

help: ## list the targets
	@grep -hE '^[a-z]+:.*## ' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "  make %-7s %s\n", $$1, $$2}'

setup: $(READY) ## make .venv and install everything, at the versions of constraints.txt

# torch comes first and by its exact version, from TORCH_INDEX if that is given: torch's page "Get started" has them.
# Without it pip takes its own index's build, which on x86 Linux is gigabytes larger: it holds CUDA.
$(READY): pyproject.toml constraints.txt
	@if [ -z "$(PYTHON)" ]; then echo "puddle needs Python 3.11, 3.12 or 3.13; found none. Install one, or name it: make PYTHON=/path/to/python" >&2; exit 2; fi
	@echo "Setting up $(VENV) with $$($(PYTHON) --version): 2 to 5 minutes; about 2 GB, or more where torch holds CUDA."
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/python -m pip install --quiet $(if $(TORCH_INDEX),--index-url "$(TORCH_INDEX)") "$$(grep '^torch==' constraints.txt)"
	$(VENV)/bin/python -m pip install --quiet --constraint constraints.txt --editable ".[dev]"
	@touch $@

study: $(READY) ## run the whole study (PRESET=laptop; also smoke, row, paper, pontoon)
	$(PUDDLE) study --preset $(PRESET)

test: $(READY) ## check style, format, types and layers, and run the tests
	$(VENV)/bin/ruff check --quiet .
	$(VENV)/bin/ruff format --check --quiet .
	$(VENV)/bin/mypy
	$(VENV)/bin/python -m pytest --numprocesses 3 --dist loadfile --no-loadscope-reorder --durations 5 --durations-min 10

torture: $(READY) ## faults in large numbers: kills, full disks, flipped bits (MINUTES=60)
	$(VENV)/bin/python -m pytest tests/torture --torture --minutes $(MINUTES)

lint: $(READY) ## check style, format, types and layers alone
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy
	$(VENV)/bin/lint-imports

ui: $(READY) ## open the MLflow UI on this machine's loopback
	$(PUDDLE) ui

bench: $(READY) ## measure the engines against their peers
	$(VENV)/bin/python -m benchmarks

clean: ## remove .venv and caches (never a store)
	rm -rf $(VENV) build dist *.egg-info .mypy_cache .pytest_cache .ruff_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
