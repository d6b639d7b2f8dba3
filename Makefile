# Targets for people with Python ≥ 3.11, venv, pip and make. Everything lives in .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --no-input
TESTS ?= tests
# Tests wait for processes and browsers, so four test processes are faster than three on two cores (575 instead of 613 s).
TEST_PROCESSES ?= 4
DEMO_OUT := petmjx-results/demo
BENCH_OUT := petmjx-results/bench.jsonl

.PHONY: demo test check lint bench pictures options docs clean help

help: ## list the targets
	@grep -hE '^[a-z]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/'

demo: $(VENV)/.runtime ## install, score the bundled plans on the CPU and print the table
	rm -rf $(DEMO_OUT)
	$(BIN)/petmjx score --engine mujoco --out $(DEMO_OUT)

test: lint ## lint, then the whole test suite, with types
	$(BIN)/python -m pytest -q -n $(TEST_PROCESSES) --dist loadfile --no-loadscope-reorder $(TESTS)

lint: $(VENV)/.dev ## lint and format only
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

check: lint ## lint, format and types only; rules for scripts of pages
	$(BIN)/mypy
	$(BIN)/python -m pytest -q tests/unit/test_page_scripts.py

bench: $(VENV)/.runtime ## two minutes of benchmarks on the CPU; benchmarks/README.md tells of the others
	$(BIN)/python -m benchmarks run stacks-16 stacks-40 W-adaptive plain-loop --limit 20 --oracle mujoco-fixed \
		--max-seconds 30 --out $(BENCH_OUT)
	$(BIN)/python -m benchmarks table $(BENCH_OUT)

pictures: $(VENV)/.dev ## draw the pictures of the documents again
	$(BIN)/python docs/pictures.py

docs: $(VENV)/.docs ## build the documentation site in site/; open site/index.html
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet --strict

options: $(VENV)/.dev ## write the types of options again, after a change of one
	$(BIN)/python -m tools.option_types

clean: ## remove the virtual environment and caches
	rm -rf $(VENV) .mypy_cache .pytest_cache .ruff_cache

$(BIN)/python:
	$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else "petmjx needs Python 3.11 or newer; set PYTHON=")'
	$(PYTHON) -m venv $(VENV)

$(VENV)/.runtime: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) install --quiet --constraint constraints.txt --editable .
	touch $@

$(VENV)/.dev: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $@ $(VENV)/.runtime

$(VENV)/.docs: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) install --quiet --constraint constraints.txt --editable '.[docs]'
	touch $@ $(VENV)/.runtime
