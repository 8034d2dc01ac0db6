# Everything happens in .venv, which the first target that needs it makes. `make help` lists the targets.

VENV := .venv
PUDDLE := $(VENV)/bin/puddle
PIP := $(VENV)/bin/python -m pip
INSTALLED := $(VENV)/.installed
INSTALLED_DEV := $(VENV)/.installed-dev

# Python files are compiled once and not in every process, whatever the shell says: a Ray worker then starts in a third
# of the time, and the tests start hundreds of processes.
export PYTHONDONTWRITEBYTECODE :=
# pip installs into .venv, whatever the shell or pip.conf says.
export PIP_USER := 0
unexport PIP_TARGET PIP_PREFIX

PRESET ?= laptop
MINUTES ?= 5
EXTRAS ?=
OPTIONS ?=
TORCH ?= $(or $(patsubst $(VENV)/.torch-%,%,$(wildcard $(VENV)/.torch-*)),cpu)
TORCH_INDEX ?=

# The first Python that runs and is one of 3.11 to 3.13; override with `make PYTHON=...`.
PYTHON ?= $(firstword $(foreach p,python3 python3.13 python3.12 python3.11,$(shell \
	$(p) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] < (3, 14))' 2>/dev/null && echo $(p))))

# $(call install,PACKAGES,TORCH OPTIONS OF PIP,TORCH OPTIONS OF UV). uv is several times as fast as pip and knows where
# torch's builds are. It reads none of pip's settings, so where pip has an index or a folder of its own, pip installs.
UV = $(or $(shell command -v uv),$(VENV)/bin/uv)
install = if [ -n "$(TORCH_INDEX)" ] || $(PIP) config list | grep -E 'index-url|find-links|no-index' >/dev/null; \
	then $(PIP) install --quiet --no-compile $(2) $(1); \
	else [ -x "$(UV)" ] || $(PIP) install --quiet uv; $(UV) pip install --quiet --python $(VENV)/bin/python $(3) $(1); fi

ifneq ($(filter-out cpu cuda,$(TORCH)),)
$(error TORCH is cpu or cuda, got $(TORCH))
endif
ifneq ($(filter-out cad dev docs mujoco search server vision,$(EXTRAS)),)
$(error EXTRAS are cad, dev, docs, mujoco, search, server and vision, got $(EXTRAS))
endif

.DEFAULT_GOAL := help
.PHONY: help setup study test torture lint docs ui bench clean

help: ## list the targets
	@grep -hE '^[a-z]+:.*## ' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "  make %-7s %s\n", $$1, $$2}'

setup: $(INSTALLED) $(EXTRAS:%=$(VENV)/.installed-%) ## install what a study needs (TORCH=cpu or cuda; EXTRAS=cad, dev, docs, mujoco, search, server, vision)

# torch comes first and by its exact version: its builds for the CPU and for CUDA differ by gigabytes. TORCH_INDEX is the
# index that pip takes it from, if not pip's own; torch's page "Get started" has the address of each build's.
$(VENV)/.torch-%: constraints.txt
	@if [ -z "$(PYTHON)" ]; then echo "puddle needs Python 3.11, 3.12 or 3.13; found none. Install one, or name it: make PYTHON=/path/to/python" >&2; exit 2; fi
	@echo "Setting up $(VENV) with $$($(PYTHON) --version) and torch for $*: 1 to 3 minutes."
	@[ -x $(VENV)/bin/python ] || $(PYTHON) -m venv $(VENV)
	@rm -f $(VENV)/.torch-*
	@$(call install,"$$(grep '^torch==' constraints.txt)",$(if $(TORCH_INDEX),--index-url "$(TORCH_INDEX)"),--torch-backend=$(if $(filter cuda,$*),auto,$*))
	@touch $@

$(INSTALLED): $(VENV)/.torch-$(TORCH) pyproject.toml constraints.txt
	@$(call install,-C editable_mode=compat --constraint constraints.txt --editable .)
	@touch $@

$(VENV)/.installed-%: $(INSTALLED)
	@$(call install,-C editable_mode=compat --constraint constraints.txt --editable ".[$*]")
	@touch $@

study: $(INSTALLED) ## run the whole study (PRESET=laptop; also smoke, row-small, row, desk, paper, pontoon, tank, fluid; OPTIONS of puddle study)
	$(PUDDLE) study --preset $(PRESET) $(OPTIONS)

test: $(INSTALLED_DEV) ## check style, format, types and layers, and run the tests
	$(VENV)/bin/ruff check --quiet .
	$(VENV)/bin/ruff format --check --quiet .
	$(VENV)/bin/mypy
	$(VENV)/bin/python -m pytest --numprocesses 3 --dist loadfile --no-loadscope-reorder --durations 5 --durations-min 10

torture: $(INSTALLED_DEV) ## faults in large numbers: kills, full disks, flipped bits (MINUTES=5 for each test)
	$(VENV)/bin/python -m pytest tests/torture tests/pipeline/cluster/test_slurm.py --torture --minutes $(MINUTES)

lint: $(INSTALLED_DEV) ## check style, format, types and layers alone
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy
	$(VENV)/bin/lint-imports

docs: $(VENV)/.installed-docs ## write the site of the docs, with a reference of the Python interface: build/site/index.html
	$(VENV)/bin/mkdocs build --quiet --strict --config-file docs/site/mkdocs.yml

ui: $(INSTALLED) ## open the MLflow UI on this machine's loopback
	$(PUDDLE) ui

bench: $(INSTALLED_DEV) ## measure the engines against their peers
	$(VENV)/bin/python -m benchmarks

clean: ## remove .venv and caches (never a store)
	rm -rf $(VENV) build dist *.egg-info .mypy_cache .pytest_cache .ruff_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
