# Two commands matter: `make demo` runs the main job on the embedded study, `make test` passes the tests.
# Both do all the set-up they need; a second call is quick.
SHELL := /bin/bash
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.setup-done

.PHONY: setup demo test lint fmt bench clean
.DEFAULT_GOAL := demo

setup: $(STAMP)

$(STAMP): requirements.lock pyproject.toml .ci/setup
	@PYTHON="$(PYTHON)" .ci/setup $(VENV)
	@touch $@

demo: $(STAMP)
	@$(BIN)/headcap run config/demo.yaml

# files side by side on two processes: a file's fixtures are made once
test: $(STAMP)
	@$(BIN)/python -m pytest -n 2 --dist loadfile

lint: $(STAMP)
	@$(BIN)/ruff format --check .
	@$(BIN)/ruff check .
	@$(BIN)/snakefmt --check --compact-diff Snakefile rules
	@$(BIN)/lint-imports
	@$(BIN)/headcap schema --check

fmt: $(STAMP)
	@$(BIN)/ruff format .
	@$(BIN)/ruff check --fix .
	@$(BIN)/snakefmt Snakefile rules
	@$(BIN)/headcap schema --write

# make bench ONLY=stereo runs one (fit, flow, head_model, high_resolution, lips, lips_unseen, neck, quasi_eigen, quasi_eigen_data, speech, stereo, talking_faces, track); each writes results/bench/<name>.json
bench: $(STAMP)
	@$(BIN)/python tests/bench/run.py $(ONLY)

clean:
	rm -rf results .snakemake .pytest_cache .ruff_cache .hypothesis .import_linter_cache
	find src tests pipeline -name __pycache__ -type d -prune -exec rm -rf {} +
