# `make demo` and `make test` are all a newcomer needs; each installs what it lacks into .venv first.

PYTHON ?= python3
BIN := .venv/bin
INSTALLED := .venv/.installed
SCENES := staircase ceiling
MODEL_DATA ?= build/model-data

.PHONY: demo test check models clean

demo: $(INSTALLED)
	$(BIN)/vapor-track demo

test: $(INSTALLED)
	$(BIN)/python -m pytest -n 2 --dist worksteal

check: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/basedpyright --level error
	$(BIN)/lint-imports

$(INSTALLED): pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --upgrade "pip>=25.1"
	$(BIN)/python -m pip install --quiet torch==2.13.0
	$(BIN)/python -m pip install --quiet --editable . --group dev
	touch $@

clean:
	rm -rf .venv build dist demo
