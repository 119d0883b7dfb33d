# Everything happens in a virtual environment .venv in this folder.
#
#   make demo    simulate an office run, map it, score the map: out/demo
#   make test    run all tests
#   make check   ruff, mypy and the import rule
#   make bench   measure the speed of the stages
#   make clean   remove the environment and what was made

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help

# The first Python of a version that we know; make PYTHON=... takes another one.
KNOWN := import sys; sys.exit(not (3, 10) <= sys.version_info[:2] < (3, 14))
PYTHON ?= $(or $(shell for python in python3 python3.13 python3.12 python3.11 python3.10; do \
	$$python -c '$(KNOWN)' 2>/dev/null && echo $$python && break; done),python3)
BIN := .venv/bin
READY := .venv/.ready

.PHONY: help demo test check bench format clean system-libraries

help:
	@sed -n 's/^#   //p' Makefile

demo: $(READY) system-libraries
	$(BIN)/rgslam demo --out out/demo

test: $(READY) system-libraries
	$(BIN)/python -m pytest

check: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python -m pytest -q tests/test_imports.py

bench: $(READY) system-libraries
	$(BIN)/python -m pytest tests/benchmarks --benchmark-only --benchmark-columns=min,median,ops,rounds

format: $(READY)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# The environment is brought up to date when what it depends on changes.
$(READY): pyproject.toml constraints.txt .ci/system-packages
	@bash .ci/system-packages venv "$(PYTHON)"
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[dev]"
	$(BIN)/python -m compileall -q rgslam
	touch $(READY)

# Open3D loads libraries of the system that no wheel brings.
system-libraries: $(READY)
	@bash .ci/system-packages open3d "$(BIN)/python"

clean:
	rm -rf .venv out build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis .benchmarks
