# `make demo` and `make test` need Python 3.11 and make, nothing else.

PYTHON ?= $(shell command -v python3.11 || command -v python3)
# On the plain index this is the CPU build on a machine that holds one, else the CUDA build.
TORCH ?= torch==2.13.0
VENV := .venv
BIN := $(VENV)/bin
DEMO := runs/demo

.PHONY: demo test lint bench install clean
.DELETE_ON_ERROR:

install: $(VENV)/.installed

$(VENV)/.installed: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' || \
	  { echo "error: Python 3.11 is needed (bpy 4.5 has wheels for it alone); name it: make PYTHON=/path/to/python3.11" >&2; exit 2; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV) || \
	  { echo "error: cannot make a virtual environment; on Debian: apt-get install -y python3.11-venv" >&2; exit 2; }
	$(BIN)/python -m pip install -q --disable-pip-version-check $(TORCH)
	$(BIN)/python -m pip install -q --disable-pip-version-check -e '.[simulate,cluster,test]'
	@touch $@

# Checked at every run: it takes a moment, and system libraries come and go without us.
.PHONY: libraries
libraries: install
	@$(BIN)/python -m simulate.render.libraries

demo: libraries
	$(BIN)/objconnect simulate --config configs/demo.yaml --out $(DEMO)/scene
	test -d $(DEMO)/scene/map || $(BIN)/objconnect map $(DEMO)/scene
	$(BIN)/objconnect validate $(DEMO)/scene
	$(BIN)/objconnect evaluate $(DEMO)/scene --method sift --out $(DEMO)/results --cache $(DEMO)/cache >/dev/null
	$(BIN)/objconnect leaderboard $(DEMO)/results --out $(DEMO)/leaderboard
	@echo "Pictures: $(DEMO)/scene/pictures, $(DEMO)/results; page: $(DEMO)/leaderboard/leaderboard.html"

# What the tests of the leaderboard's page click in.
.PHONY: browser
browser: install
	@$(BIN)/python -m tests.browser

test: libraries browser lint
	$(BIN)/python -m pytest

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

clean:
	rm -rf $(VENV) runs build *.egg-info

# Everything about speed and memory, in one run; tens of minutes.
bench: libraries
	$(BIN)/python -m pytest tests/benchmarks -m '' -s --benchmark-enable --benchmark-columns=median,iqr,rounds
	$(BIN)/python -m tests.benchmarks.frame_cost
	$(BIN)/python -m tests.benchmarks.build_cost
