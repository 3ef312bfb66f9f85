# Two commands set everything up: `make demo` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
DEMO := topobatch-workspace
# Not among them: what wants files to be named or hours; benchmarks/README.md lists them.
BENCHMARKS := startup paper merging aliasing adversaries calibration odometry uncertainty transforms closure chain fleet \
	exports transfer changes grids next ingest soak remote audit
# What the program needs, and that with the tools of its tests.
LOCK := requirements.lock
DEV_LOCK := requirements-dev.lock
UV := uv==0.13.9
LOCKED := --universal --python-version 3.11 --generate-hashes --quiet \
	--custom-compile-command 'make lock'

.DEFAULT_GOAL := help
.PHONY: help demo test check lint types samples docs bench attack lock clean

help:  ## list the targets
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z]+):.*## (.*)/  make \1|\2/' | column -t -s '|'

PIP := $(BIN)/python -m pip --disable-pip-version-check
CHECKED := --require-hashes --no-deps

# Made anew whenever the dependencies change: exactly what the lock files name, checked by hashes.
$(VENV)/.runs: pyproject.toml $(LOCK)
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "Python 3.11 or newer is needed; try: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(PIP) install $(CHECKED) -r $(LOCK)
	PYTHONWARNINGS=ignore $(PIP) install --quiet --no-deps --no-build-isolation --editable .
	@touch $@

$(VENV)/.ready: $(VENV)/.runs $(DEV_LOCK)
	$(PIP) install --quiet $(CHECKED) -r $(DEV_LOCK)
	@touch $@

demo: $(VENV)/.runs  ## ingest and merge the sample logs, say where to look
	$(BIN)/topobatch ingest sample_logs --workspace $(DEMO)
	$(BIN)/topobatch merge --all --workspace $(DEMO)
	$(BIN)/topobatch report --workspace $(DEMO)
	@echo
	@echo "Look at the results with: $(BIN)/topobatch view --workspace $(DEMO)"
	@echo "or, in a browser: $(DEMO)/report.html"
	@ls $(DEMO)/merged.rrd $(DEMO)/maps/*.rrd

# The suite starts hundreds of processes: modules are compiled once, also where that is switched off.
test: $(VENV)/.ready  ## run the tests
	PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest -n auto -m "not slow"

lint: $(VENV)/.ready
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .

# mypy wants the folder to be called like the package; a clone may be called anything.
types: $(VENV)/.ready
	@mkdir -p $(VENV)/src && ln -sfn "$(CURDIR)" $(VENV)/src/topobatch
	MYPYPATH=$(VENV)/src $(BIN)/mypy -p topobatch
	$(BIN)/mypy --config-file benchmarks/mypy.ini benchmarks/*.py

check: lint types test  ## everything that CI runs

samples: $(VENV)/.ready  ## write sample_logs/ anew (the same messages)
	$(BIN)/python -m topobatch.simulation.samples sample_logs

docs: $(VENV)/.ready  ## make the README's picture anew (wants a Vulkan driver: mesa-vulkan-drivers)
	$(BIN)/python benchmarks/picture.py

bench: $(VENV)/.ready  ## the long suites: slow tests and every benchmark
	$(BIN)/python -m pytest -m slow
	for name in $(BENCHMARKS); do \
		echo "== benchmarks/$$name.py"; $(BIN)/python benchmarks/$$name.py || exit 1; \
	done

attack: $(VENV)/.ready  ## thousands of hostile logs, documents, kills and races (some 40 minutes)
	$(BIN)/python tests/hostile/attack.py

# Releases younger than a week are passed over: bad ones are mostly found by then.
lock:  ## raise the locked dependencies to their newest versions
	$(PYTHON) -m venv $(VENV)/lock
	$(VENV)/lock/bin/python -m pip install --quiet --disable-pip-version-check '$(UV)'
	$(VENV)/lock/bin/uv pip compile pyproject.toml --extra dev --upgrade --exclude-newer '7 days' \
		$(LOCKED) --output-file $(DEV_LOCK)
	$(VENV)/lock/bin/uv pip compile pyproject.toml --extra build --constraint $(DEV_LOCK) \
		$(LOCKED) --output-file $(LOCK)

clean:  ## remove what the targets above made
	rm -rf $(VENV) $(DEMO) build dist *.egg-info .mypy_cache .pytest_cache .ruff_cache .hypothesis
