# Every target makes its own virtual environment first; a bare machine needs python3 (3.11 or later) and make.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
READY  := $(VENV)/.ready
TOOLS  := $(VENV)/.ready-for-tests
INSTALL = -m pip install --quiet --disable-pip-version-check

.PHONY: demo test test-all bench lint clean
demo: $(READY)
	$(BIN)/leadline demo

test: $(TOOLS) lint
	$(BIN)/python -m pytest -n 2 -m "not long"

test-all: $(TOOLS) lint
	$(BIN)/python -m pytest -n 2

bench: $(TOOLS)
	$(BIN)/python -m benchmarks

lint: $(TOOLS)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

$(READY): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python $(INSTALL) --upgrade "pip>=25.1"
	$(BIN)/python $(INSTALL) --constraint constraints.txt --editable .
	touch $@

$(TOOLS): $(READY)
	$(BIN)/python $(INSTALL) --constraint constraints.txt --editable '.[train,live,mavlink]' --group dev
	touch $@

clean:
	rm -rf $(VENV) out build dist
