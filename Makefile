# `make demo` and `make test` are all a newcomer needs; each installs what it lacks into .venv first.

PYTHON ?= python3
BIN := .venv/bin
INSTALLED := .venv/.installed
DATA := build/model-data

STAIRCASE_FEW := $(foreach seed,$(shell seq 0 19),$(DATA)/staircase-$(seed).mcap)
STAIRCASE := $(foreach seed,$(shell seq 0 99),$(DATA)/staircase-$(seed).mcap)
STAIRCASE_MORE := $(foreach seed,$(shell seq 104 137),$(DATA)/staircase-$(seed).mcap)
STAIRCASE_HELD_OUT := $(foreach seed,$(shell seq 100 103),$(DATA)/staircase-$(seed).mcap)
CEILING_FEW := $(foreach seed,$(shell seq 0 23),$(DATA)/ceiling-$(seed).mcap)
CEILING_MORE := $(foreach seed,$(shell seq 0 71),$(DATA)/ceiling-$(seed).mcap)
CEILING := $(foreach seed,$(shell seq 0 99),$(DATA)/ceiling-$(seed).mcap)
CEILING_HELD_OUT := $(foreach seed,$(shell seq 100 103),$(DATA)/ceiling-$(seed).mcap)
# What the defaults were when the models that ship were trained; the rate is given with each training.
FORMER := --preset demo --network.no-shortcut --loss.position-unit metre --initial-log-variance 0 --batch-size 64
SQUARE := $(FORMER) --network.image-width 128 --network.image-height 128 --network.shortest-edge 146

.PHONY: demo test check fuzz models clean

demo: $(INSTALLED)
	$(BIN)/vapor-track demo

test: $(INSTALLED)
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist worksteal  # two workers: BLAS threads would only spin

check: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/basedpyright --project pyproject.toml --level error
	$(BIN)/lint-imports

# Damaged files for every reader; `make fuzz SECONDS=60 FUZZ="--reader mcap-zstd --seed 1"`, see tests/fuzz.
SECONDS ?= 600
fuzz: $(INSTALLED)
	OMP_NUM_THREADS=1 $(BIN)/python -m tests.fuzz --seconds $(SECONDS) $(FUZZ)

$(INSTALLED): pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --upgrade "pip>=25.1"
	$(BIN)/python -m pip install --quiet torch==2.13.0
	$(BIN)/python -m pip install --quiet --editable . --group dev
	touch $@

# How the models that ship were trained: about six hours on two cores (`make -j2 models`); see docs/models.md.
models: vapor/models/staircase.safetensors vapor/models/ceiling.safetensors

$(DATA)/staircase-%.mcap: | $(INSTALLED) $(DATA)
	$(BIN)/vapor-track synthesize staircase $@ --seed $* --frames 500 --split train --width 240 --height 180

$(DATA)/ceiling-%.mcap: | $(INSTALLED) $(DATA)
	$(BIN)/vapor-track synthesize ceiling $@ --seed $* --frames 500 --split train --width 240 --height 180

$(DATA)/features.safetensors: $(STAIRCASE_FEW) $(DATA)/staircase-100.mcap
	$(BIN)/vapor-track train $(STAIRCASE_FEW) --validation $(DATA)/staircase-100.mcap --output $@ \
	    $(SQUARE) --loss.alpha 0.1 --learning-rate 1e-3 --epochs 16 --no-calibrate

$(DATA)/staircase-first.safetensors: $(DATA)/features.safetensors
	$(BIN)/vapor-track train $(STAIRCASE_FEW) --validation $(DATA)/staircase-100.mcap --output $@ \
	    $(SQUARE) --pretrained-weights $< --loss.alpha 0.1 --learning-rate 1e-3 --epochs 28 --no-calibrate

$(DATA)/staircase-second.safetensors: $(DATA)/staircase-first.safetensors $(STAIRCASE)
	$(BIN)/vapor-track train $(STAIRCASE) --validation $(DATA)/staircase-100.mcap --output $@ \
	    $(SQUARE) --initial-model $< --loss.alpha 0.1 --loss.beta 0.005 --learning-rate 1.5e-3 --epochs 12 --no-calibrate

# The square from the middle leaves out what is at the sides; the weights fit the whole image as well.
$(DATA)/staircase.safetensors: $(DATA)/staircase-second.safetensors $(STAIRCASE) $(STAIRCASE_MORE)
	$(BIN)/vapor-track train $(STAIRCASE) $(STAIRCASE_MORE) --validation $(DATA)/staircase-100.mcap --output $@ \
	    $(FORMER) --initial-model $< --loss.alpha 0.1 --loss.beta 0.005 --learning-rate 1.5e-3 --epochs 7 \
	    --select-by log_density --no-calibrate

# Few images and many winners tell the like places apart, if at the cost of some; more images and fewer winners bring
# those back; more images still tell them apart better.
$(DATA)/ceiling-first.safetensors: $(DATA)/features.safetensors $(CEILING_FEW) $(DATA)/ceiling-100.mcap
	$(BIN)/vapor-track train $(CEILING_FEW) --validation $(DATA)/ceiling-100.mcap --output $@ \
	    $(SQUARE) --pretrained-weights $< --loss.alpha 0.06 --loss.num-samples 333 --loss.beta 0.003 \
	    --learning-rate 3e-3 --evolve 0.4 --epochs 44 --no-calibrate

$(DATA)/ceiling-second.safetensors: $(DATA)/ceiling-first.safetensors $(CEILING_MORE)
	$(BIN)/vapor-track train $(CEILING_MORE) --validation $(DATA)/ceiling-100.mcap --output $@ \
	    $(SQUARE) --initial-model $< --loss.alpha 0.045 --loss.num-samples 333 --loss.beta 0.003 \
	    --learning-rate 2e-3 --epochs 16 --no-calibrate

$(DATA)/ceiling-third.safetensors: $(DATA)/ceiling-second.safetensors $(CEILING)
	$(BIN)/vapor-track train $(CEILING) --validation $(DATA)/ceiling-100.mcap --output $@ \
	    $(SQUARE) --initial-model $< --loss.alpha 0.045 --loss.num-samples 333 --loss.beta 0.003 \
	    --learning-rate 2e-3 --epochs 20 --no-calibrate

$(DATA)/ceiling.safetensors: $(DATA)/ceiling-third.safetensors $(CEILING)
	$(BIN)/vapor-track train $(CEILING) --validation $(DATA)/ceiling-100.mcap --output $@ \
	    $(FORMER) --initial-model $< --loss.alpha 0.045 --loss.num-samples 333 --loss.beta 0.003 \
	    --learning-rate 2e-3 --epochs 12 --select-by log_density --no-calibrate

# Errors of images last for metres: of one sequence too few are independent.
vapor/models/staircase.safetensors: $(DATA)/staircase.safetensors $(STAIRCASE_HELD_OUT)
	$(BIN)/vapor-track calibrate $< $(STAIRCASE_HELD_OUT) --training $(STAIRCASE) --images 2000 --output $@

vapor/models/ceiling.safetensors: $(DATA)/ceiling.safetensors $(CEILING_HELD_OUT)
	$(BIN)/vapor-track calibrate $< $(CEILING_HELD_OUT) --training $(CEILING) --images 2000 --output $@

$(DATA):
	mkdir -p $@

clean:
	rm -rf .venv build dist demo
