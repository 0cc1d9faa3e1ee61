PYTHON ?= python3
VENV := .venv
RUN := $(VENV)/bin/python
READY := $(VENV)/.ready

.DEFAULT_GOAL := help
.PHONY: help setup run paper test test-slow ui lint type clean

help:  ## list the commands
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

setup: $(READY)  ## make .venv with everything that softrl needs

# torch first and alone: a range that admits a newer build would fetch gigabytes of CUDA packages
$(READY): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "softrl needs Python 3.11 or newer")'
	$(PYTHON) -m venv $(VENV)
	$(RUN) -m pip install --quiet --disable-pip-version-check -c constraints.txt torch==2.13.0
	$(RUN) -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[test]'
	touch $@

run: $(READY)  ## the whole loop with the quick profile: from a robot to a diagnosis
	$(RUN) -m softrl stage=all profile=quick

paper: $(READY)  ## the paper's tables beside ours: five seeds at full size, many hours; stop and start it as you like
	$(RUN) -m softrl stage=paper profile=paper stage.keep=experiments/paper.json

test: $(READY)  ## tests of laws and of the command line, about 12 minutes
	$(RUN) -m pytest -n 2 --dist loadfile --no-loadscope-reorder

test-slow: $(READY)  ## what takes longer, and what needs real recordings
	$(RUN) -m pytest -n 2 --dist loadfile -m slow

ui: $(READY)  ## browse runs, metrics, figures and reports at http://127.0.0.1:5000
	MLFLOW_DISABLE_TELEMETRY=true $(VENV)/bin/mlflow ui --workers 1 --host 127.0.0.1 --port 5000 \
	  --backend-store-uri sqlite:///$(CURDIR)/mlflow.db

lint: $(READY)  ## style
	$(VENV)/bin/ruff check softrl tests

type: $(READY)  ## types of the foundations
	$(VENV)/bin/mypy

clean:  ## remove the environment, caches and outputs; keeps mlflow.db and mlartifacts
	rm -rf $(VENV) outputs multirun .pytest_cache .ruff_cache .mypy_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
