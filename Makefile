# `make demo` and `make test` need Python 3.11 and make, nothing else.

PYTHON ?= $(shell command -v python3.11 || command -v python3)
# On the plain index this is the CPU build on a machine that holds one, else the CUDA build.
TORCH ?= torch==2.13.0
VENV := .venv
BIN := $(VENV)/bin
DEMO := runs/demo
# Processes that share the tests; auto: one a core.
WORKERS ?= auto
DOCS := runs/docs-venv

.PHONY: demo test test-rest test-all lint bench bench-check install clean weights
.DELETE_ON_ERROR:

install: $(VENV)/.installed

$(VENV)/.installed: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' || \
	  { echo "error: Python 3.11 is needed (bpy 4.5 has wheels for it alone); name it: make PYTHON=/path/to/python3.11" >&2; exit 2; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV) || \
	  { echo "error: cannot make a virtual environment; on Debian: apt-get install -y python3.11-venv" >&2; exit 2; }
	$(BIN)/python -m pip install -q --disable-pip-version-check $(TORCH)
	$(BIN)/python -m pip install -q --disable-pip-version-check -e '.[simulate,cluster,fast,geo,video,robot,rerun,test]'
	@touch $@

# Checked at every run: it takes a moment, and system libraries come and go without us.
.PHONY: libraries
libraries: install
	@$(BIN)/python -m simulate.render.libraries

demo: libraries
	$(BIN)/objconnect simulate --config configs/demo.yaml --out $(DEMO)/scene
	test -d $(DEMO)/scene/map || $(BIN)/objconnect map $(DEMO)/scene
	$(BIN)/objconnect validate $(DEMO)/scene
	$(BIN)/objconnect evaluate $(DEMO)/scene --method sift --method pixloc --method objconnect \
	  --out $(DEMO)/results --cache $(DEMO)/cache >/dev/null
	$(BIN)/objconnect leaderboard $(DEMO)/results --out $(DEMO)/leaderboard
	$(BIN)/objconnect view $(DEMO)/scene --results $(DEMO)/results --out $(DEMO)/view.html
	@echo "Look at: $(DEMO)/leaderboard/leaderboard.html, $(DEMO)/view.html, $(DEMO)/scene/pictures"

# The page of all tracks, from the results in leaderboard/; seconds, and no pictures are rendered.
.PHONY: leaderboard
leaderboard: install
	$(BIN)/objconnect leaderboard --board leaderboard --out runs/leaderboard >/dev/null
	@echo "Look at: runs/leaderboard/leaderboard.html"

# What the tests of the leaderboard's page click in.
.PHONY: browser
browser: install
	@$(BIN)/python -m tests.browser

# What a contributor runs before a commit: minutes, on all cores.
test: libraries browser lint
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadscope

# Programs of others that read our exports, outside the environment.
.PHONY: peers
peers: install
	@$(BIN)/python -m tests.peers

# What CI runs besides: the site, kills, clusters, wheels, damaged files.
test-rest: libraries browser peers docs
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadscope -m thorough
	$(BIN)/python -m tests.fuzz --inputs 2000

# Ten random moments of every kill, every camera, every mutant; tens of minutes more.
test-all: test test-rest
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadscope -m slow

# The site of the documents, runs/site, in an environment of its own, with the page of all tracks.
.PHONY: docs
docs: $(DOCS)/.installed leaderboard
	NO_MKDOCS_2_WARNING=1 $(DOCS)/bin/mkdocs build --strict

$(DOCS)/.installed: pyproject.toml
	@test -x $(DOCS)/bin/python || $(PYTHON) -m venv $(DOCS)
	$(DOCS)/bin/python -m pip install -q --disable-pip-version-check $$($(DOCS)/bin/python -c \
	  "import tomllib; print(*tomllib.load(open('pyproject.toml', 'rb'))['project']['optional-dependencies']['docs'])")
	@touch $@

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

clean:
	rm -rf $(VENV) runs build *.egg-info

# Everything about speed and memory, in one run; tens of minutes. Its ratios are runs/bench/ratios.json.
BENCH := runs/bench
bench: libraries
	mkdir -p $(BENCH)
	$(BIN)/python -m pytest tests/benchmarks -m '' -s --benchmark-enable --benchmark-columns=median,iqr,rounds \
	  --benchmark-json=$(BENCH)/run.json
	$(BIN)/python -m tests.benchmarks.ratios write $(BENCH)/run.json $(BENCH)/ratios.json
	$(BIN)/python -m tests.benchmarks.frame_cost
	$(BIN)/python -m tests.benchmarks.build_cost

# Fails where a ratio is worse than in an earlier run, by more than its spread.
bench-check: install
	@test -n "$(AGAINST)" || { echo "error: name the ratios of an earlier run: make bench-check AGAINST=ratios.json" >&2; exit 2; }
	$(BIN)/python -m tests.benchmarks.ratios check $(BENCH)/ratios.json --against $(AGAINST)

# The weights that come with the project, from their seeds; many hours, and an interrupted run goes
# on where it was. PHOTOS, if given, is a folder of plain aerial photographs.
W := runs/weights
SIX := town-1001 suburb-1011 town-1002 park-1021 town-1003 industrial-1031
NINE := $(SIX) town-1004 town-1005 suburb-1012
place = $(patsubst %,$(W)/%/scene.json,$(1) town-101)
# Method, places, configuration, and the run whose weights it begins with.
train = $(BIN)/objconnect train $(1) $(2:%=--data $(W)/%) --validation $(W)/town-101 \
  --config configs/train/$(3).yaml $(if $(PHOTOS),--set 'photographs=[$(PHOTOS)]') \
  $(if $(4),--set weights=$(W)/$(4)/weights.safetensors) --out $(@D)
learned = $(W)/$(1)/weights.safetensors

weights: $(call learned,d2net) $(call learned,objconnect) $(call learned,objconnect-objects) \
  $(call learned,connected) $(call learned,supplement)

$(W)/%/scene.json: | libraries
	$(BIN)/objconnect simulate --config configs/train/scene.yaml --preset $(firstword $(subst -, ,$*)) \
	  --seed $(lastword $(subst -, ,$*)) --out $(@D)

$(call learned,pixloc-features): $(call place,$(SIX))
	$(call train,pixloc,$(SIX),pixloc-features,)

$(call learned,pixloc): $(call learned,pixloc-features)
	$(call train,pixloc,$(SIX),pixloc,pixloc-features)

$(call learned,pixloc-further): $(call learned,pixloc)
	$(call train,pixloc,$(SIX),pixloc-further,pixloc)

$(call learned,pixloc-upright): $(call learned,pixloc-further)
	$(call train,pixloc,$(SIX),pixloc-upright,pixloc-further)

$(call learned,d2net): $(call learned,pixloc-upright)
	$(call train,d2net,$(SIX),d2net,pixloc-upright)

$(call learned,objconnect): $(call learned,pixloc-upright) $(call place,$(NINE))
	$(call train,objconnect,$(NINE),objconnect,pixloc-upright)

$(call learned,objconnect-objects): $(call learned,pixloc-upright)
	$(call train,objconnect,$(SIX),objconnect-objects,pixloc-upright)

# Objects: a detector on the network of objconnect, then a graph over what it finds in maps and
# queries. The result is what the project ships as objconnect.
CHANGED := town-1101 park-1121 town-1102 suburb-1111
CONNECTED := $(CHANGED) town-1103 farmland-1141 industrial-1131
changed = $(patsubst %,$(W)/changed-%/map/points3D.bin,$(1))

$(W)/changed-%/map/points3D.bin: | libraries
	$(BIN)/objconnect simulate --config configs/train/changed.yaml --preset $(firstword $(subst -, ,$*)) \
	  --seed $(lastword $(subst -, ,$*)) --out $(W)/changed-$*
	$(BIN)/objconnect map $(W)/changed-$*

$(call learned,objects): $(call learned,objconnect) $(call changed,$(CHANGED))
	$(BIN)/objconnect train objects $(CHANGED:%=--data $(W)/changed-%) \
	  --config configs/train/objects-detector.yaml --set weights=$< --out $(@D)

$(call learned,connected): $(call learned,objects) $(call changed,$(CONNECTED))
	mkdir -p $(@D)
	$(BIN)/python -m objconnect.constellation_training $(CONNECTED:%=$(W)/changed-%) --weights $< --out $@

# The three learned methods on equal terms: the features of objconnect to begin with, the same places over
# the year from above and along streets, the same steps. `make equal` makes them.
SEASONS := town-1201 suburb-1211 park-1221 park-1222 farmland-1241 industrial-1231 street-1251 street-1252
EQUAL := pixloc d2net objconnect
FEATURES_ALONE := network={segmentation: none, attention: false, object_graph: false, scene_graph: false}

# Objects are learned from those places that are seen from above.
ABOVE := $(filter-out street-%,$(SEASONS))

.PHONY: equal
equal: $(EQUAL:%=$(W)/equal-%/weights.safetensors) $(call learned,equal-connected)

$(W)/season-%/scene.json: | libraries
	$(BIN)/objconnect simulate --config configs/train/$(if $(filter street-%,$*),street,seasons).yaml \
	  --preset $(firstword $(subst -, ,$*)) --seed $(lastword $(subst -, ,$*)) --out $(@D)

$(call learned,shared): $(call learned,objconnect)
	$(BIN)/python -m objconnect.as_pixloc $< $@

$(W)/equal-%/weights.safetensors: $(call learned,shared) $(SEASONS:%=$(W)/season-%/scene.json)
	$(BIN)/objconnect train $* $(SEASONS:%=--data $(W)/season-%) --config configs/train/equal.yaml \
	  --set weights=$< $(if $(filter objconnect,$*),--set '$(FEATURES_ALONE)') \
	  $(if $(PHOTOS),--set 'photographs=[$(PHOTOS)]') --out $(@D)

$(W)/season-%/map/points3D.bin: $(W)/season-%/scene.json
	$(BIN)/objconnect map $(W)/season-$*

$(call learned,equal-objects): $(call learned,equal-objconnect) $(ABOVE:%=$(W)/season-%/scene.json)
	$(BIN)/objconnect train objects $(ABOVE:%=--data $(W)/season-%) \
	  --config configs/train/objects-detector.yaml --set weights=$< --out $(@D)

$(call learned,equal-connected): $(call learned,equal-objects) $(ABOVE:%=$(W)/season-%/map/points3D.bin)
	mkdir -p $(@D)
	$(BIN)/python -m objconnect.constellation_training $(ABOVE:%=$(W)/season-%) --weights $< --out $@

# Further, on more places and in larger pictures: for a GPU. `make further` makes the shipped weights of
# objconnect; `make further-pixloc` and `make full-width` what docs/evidence/further.md compares with them.
MORE := $(sort $(SEASONS) town-1202 town-1204 suburb-1212 park-1223 park-1224 park-1225 park-1226 farmland-1242 \
  farmland-1243 farmland-1244 farmland-1245 farmland-1246 industrial-1232 street-1253)
MORE_ABOVE := $(filter-out street-%,$(MORE))
# The graph over objects needs maps.
MORE_MAPPED := $(ABOVE) town-1202 park-1223 farmland-1242 farmland-1244 suburb-1212 industrial-1232
train_further = $(BIN)/objconnect train $(1) $(MORE:%=--data $(W)/season-%) --config configs/train/$(2).yaml \
  $(if $(3),--set weights=$(3)) $(if $(PHOTOS),--set 'photographs=[$(PHOTOS)]') --out $(@D)

.PHONY: further further-pixloc full-width
further: $(call learned,further-connected)
further-pixloc full-width: %: $(W)/%/weights.safetensors

$(call learned,further-pixloc): $(call learned,equal-pixloc) $(MORE:%=$(W)/season-%/scene.json)
	$(call train_further,pixloc,further,$<)

$(call learned,further-objconnect): $(call learned,equal-connected) $(MORE:%=$(W)/season-%/scene.json)
	$(call train_further,objconnect,further,$<)

$(call learned,full-width): $(MORE:%=$(W)/season-%/scene.json)
	$(call train_further,objconnect,full-width,)

$(call learned,further-objects): $(call learned,further-objconnect)
	$(BIN)/objconnect train objects $(MORE_ABOVE:%=--data $(W)/season-%) --set batch=8 \
	  --config configs/train/objects-detector.yaml --set weights=$< --out $(@D)

$(call learned,further-connected): $(call learned,further-objects) $(MORE_MAPPED:%=$(W)/season-%/map/points3D.bin)
	mkdir -p $(@D)
	$(BIN)/python -m objconnect.constellation_training $(MORE_MAPPED:%=$(W)/season-%) --weights $< --out $@

# Maps with their photographs: what places on small things are learned from.
MAPPED := map-1001 map-1002 map-1003

$(W)/map-%/map/points3D.bin: | libraries
	$(BIN)/objconnect simulate --config configs/train/objects.yaml --preset town --seed $* --out $(W)/map-$*
	$(BIN)/objconnect map $(W)/map-$*

$(call learned,supplement): $(MAPPED:%=$(W)/%/map/points3D.bin) $(W)/map-102/map/points3D.bin
	$(BIN)/python -m mapping.supplement.learning $(MAPPED:%=$(W)/%) --validation $(W)/map-102 --out $@
