# `make demo` and `make test` are all a newcomer needs; each installs what it lacks into .venv first.

PYTHON ?= python3
BIN := .venv/bin
INSTALLED := .venv/.installed
DATA := build/model-data

STAIRCASE := $(foreach seed,$(shell seq 0 19),$(DATA)/staircase-$(seed).mcap)
CEILING := $(foreach seed,$(shell seq 0 23),$(DATA)/ceiling-$(seed).mcap)

.PHONY: demo test check models clean

demo: $(INSTALLED)
	$(BIN)/vapor-track demo

test: $(INSTALLED)
	$(BIN)/python -m pytest -n 2 --dist worksteal

check: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/basedpyright --project pyproject.toml --level error
	$(BIN)/lint-imports

$(INSTALLED): pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --upgrade "pip>=25.1"
	$(BIN)/python -m pip install --quiet torch==2.13.0
	$(BIN)/python -m pip install --quiet --editable . --group dev
	touch $@

# How the models that ship were trained: over an hour on two cores (`make -j2 models`); see docs/models.md.
models: vapor/models/staircase.safetensors vapor/models/ceiling.safetensors

$(DATA)/staircase-%.mcap: | $(INSTALLED) $(DATA)
	$(BIN)/vapor-track synthesize staircase $@ --seed $* --frames 500 --split train

$(DATA)/ceiling-%.mcap: | $(INSTALLED) $(DATA)
	$(BIN)/vapor-track synthesize ceiling $@ --seed $* --frames 500 --split train

$(DATA)/features.safetensors: $(STAIRCASE) $(DATA)/staircase-100.mcap
	$(BIN)/vapor-track train $(STAIRCASE) --validation $(DATA)/staircase-100.mcap --output $@ \
	    --loss.alpha 0.1 --epochs 16

vapor/models/staircase.safetensors: $(DATA)/features.safetensors
	$(BIN)/vapor-track train $(STAIRCASE) --validation $(DATA)/staircase-100.mcap --output $@ \
	    --pretrained-weights $< --loss.alpha 0.1 --epochs 28

vapor/models/ceiling.safetensors: $(DATA)/features.safetensors $(CEILING) $(DATA)/ceiling-100.mcap
	$(BIN)/vapor-track train $(CEILING) --validation $(DATA)/ceiling-100.mcap --output $@ \
	    --pretrained-weights $< --loss.alpha 0.04 --loss.num-samples 512 --network.hidden-layers 6 --epochs 24

$(DATA):
	mkdir -p $@

clean:
	rm -rf .venv build dist demo
