# Two commands set everything up: `make demo` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
DEMO := topobatch-workspace
# posegraph.py is not among them: it wants the names of public graph files.
BENCHMARKS := startup paper merging calibration odometry closure chain ingest

.DEFAULT_GOAL := help
.PHONY: help demo test check lint types samples docs bench clean

help:  ## list the targets
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z]+):.*## (.*)/  make \1|\2/' | column -t -s '|'

# Made anew whenever the dependencies change.
$(VENV)/.ready: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "Python 3.11 or newer is needed; try: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --upgrade pip
	PYTHONWARNINGS=ignore $(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@

demo: $(VENV)/.ready  ## ingest and merge the sample logs, say where to look
	$(BIN)/topobatch ingest sample_logs --workspace $(DEMO)
	$(BIN)/topobatch merge --all --workspace $(DEMO)
	@echo
	@echo "Look at the results with: $(BIN)/topobatch view --workspace $(DEMO)"
	@ls $(DEMO)/merged.rrd $(DEMO)/maps/*.rrd

test: $(VENV)/.ready  ## run the tests
	$(BIN)/python -m pytest -n auto -m "not slow"

lint: $(VENV)/.ready
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .

# mypy wants the folder to be called like the package; a clone may be called anything.
types: $(VENV)/.ready
	@mkdir -p $(VENV)/src && ln -sfn "$(CURDIR)" $(VENV)/src/topobatch
	MYPYPATH=$(VENV)/src $(BIN)/mypy -p topobatch

check: lint types test  ## everything that CI runs

samples: $(VENV)/.ready  ## write sample_logs/ anew (the same bytes)
	$(BIN)/python -m topobatch.ingest.simulation.samples sample_logs

docs: $(VENV)/.ready  ## make the README's picture anew (wants a Vulkan driver: mesa-vulkan-drivers)
	$(BIN)/python benchmarks/picture.py

bench: $(VENV)/.ready  ## the long suites: slow tests and every benchmark
	$(BIN)/python -m pytest -m slow
	for name in $(BENCHMARKS); do \
		echo "== benchmarks/$$name.py"; $(BIN)/python benchmarks/$$name.py || exit 1; \
	done

clean:  ## remove what the targets above made
	rm -rf $(VENV) $(DEMO) build dist *.egg-info .mypy_cache .pytest_cache .ruff_cache .hypothesis
