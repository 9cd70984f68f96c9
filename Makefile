# Every target makes its own virtual environment first; a bare machine needs python3 (3.11 or later) and make.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
READY  := $(VENV)/.ready
TOOLS  := $(VENV)/.ready-for-tests
ROS    := .venv-ros
INSTALL = -m pip install --quiet --disable-pip-version-check

.PHONY: demo test test-all bench faults ros lint clean
demo: $(READY)
	$(BIN)/leadline demo

test: $(TOOLS) lint
	$(BIN)/python -m pytest -n 2 -m "not long"

test-all: $(TOOLS) lint
	$(BIN)/python -m pytest -n 2

bench: $(TOOLS)
	$(BIN)/python -m benchmarks

# Seven parts, seven faults each: how soon each is told and taken back, as a table and as CSV.
faults: $(TOOLS)
	$(BIN)/python -m benchmarks.faults --out out/faults.csv

# A Python with ROS 2 (community wheels: Linux on x86-64, Python 3.11), for the tests that need one.
ros: $(ROS)/.ready
$(ROS)/.ready: $(READY)
	$(PYTHON) -m venv $(ROS)
	$(ROS)/bin/python $(INSTALL) 'ros-jazzy-rclpy[fastrtps]' ros-jazzy-sensor-msgs ros-jazzy-geometry-msgs ros-jazzy-stereo-msgs \
	  ros-jazzy-diagnostic-msgs ros-jazzy-lifecycle-msgs
	touch $@

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
	rm -rf $(VENV) $(ROS) out build dist
