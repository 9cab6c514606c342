# Two commands do everything on a machine with Python 3.11 or newer: `make run` and `make test`.
# pip's own settings (PIP_* variables, pip.conf) stay in force: mirrors, caches, certificates.

SHELL := /bin/sh
VENV := .venv
BIN := $(VENV)/bin

# The main command of `make run`: the passive vehicle, the paper's four controllers, the best tuned controller and the
# first learned policy side by side, on worn wheels.
RUN_COMMAND = $(BIN)/sayd evaluate --policies passive,mppt1,mppt2,skyhook-onoff,skyhook-continuous,hunting-schedule-tuned,ppo \
          --profile worn --speeds 300,350,400 --seeds 10

# Options for the tests, for example `make test PYTEST_OPTIONS="-k contact"`.
PYTEST_OPTIONS =

# The commit beside which `make bench-check` measures, and options such as --only sayd-batch,ppo --rounds 5 --json.
BASE = 7a16f1b
BENCH_OPTIONS =

# The oldest Gymnasium that pyproject.toml allows.
OLDEST = $(shell sed -n 's/.*"gymnasium>=\([0-9.]*\),.*/\1/p' pyproject.toml)

# What `make coverage` measures with compiled kernels.
COVERAGE_TESTS = tests

# Tests that reach kernels within minutes while Python runs them, beside the program tests/test_uncompiled.py.
UNCOMPILED = tests/baselines tests/stability tests/agents/test_products.py tests/physics/test_rows.py \
             tests/physics/test_throttle.py tests/physics/contact/test_polach.py

.PHONY: run test docs test-pages test-clients test-gymnasium-oldest coverage bench-check lint dist clean
.DEFAULT_GOAL := run

run: $(VENV)/.installed
	$(RUN_COMMAND)

test: $(VENV)/.installed $(VENV)/.learning
	$(BIN)/python tests/warm_up.py
	$(BIN)/python -m pytest -n auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder --durations=20 --ignore tests/pages $(PYTEST_OPTIONS)

# The site, in build/site: warnings are errors. Building and reading it need no network.
docs: $(VENV)/.installed $(VENV)/.pages
	DISABLE_MKDOCS_2_WARNING=true NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

# The site and the pages of results, opened in an installed Chromium. With CI=true a lack of it fails, else it skips.
test-pages: docs
	$(BIN)/python -m pytest --durations=5 tests/pages $(PYTEST_OPTIONS)

# The environments as other libraries take them: their own checks, short trainings of the examples, videos.
test-clients: $(VENV)/.clients
	$(BIN)/python tests/warm_up.py
	$(BIN)/python -m pytest -n auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder --durations=10 \
	  tests/envs/test_clients.py tests/agents/test_sb3_vec.py tests/agents/test_sb3_check.py tests/test_examples.py \
	  tests/studies/test_render.py \
	  $(PYTEST_OPTIONS)

# The environments and their clients with the oldest Gymnasium, which is fetched.
test-gymnasium-oldest: $(VENV)/.installed $(VENV)/.learning
	$(BIN)/python -m pip install --quiet --no-deps --upgrade --target build/gymnasium-oldest gymnasium==$(OLDEST)
	PYTHONPATH=build/gymnasium-oldest $(BIN)/python -m pytest -n auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder \
	  tests/envs tests/agents/test_sb3_vec.py tests/agents/test_sb3_check.py $(PYTEST_OPTIONS)

# Branches that the tests reach: the kernels where Python runs them, all else where they are compiled. Python's numbers warn
# of infinities, compiled ones do not.
coverage: $(VENV)/.learning $(VENV)/.coverage
	rm -rf build/coverage
	mkdir -p build/coverage
	$(BIN)/python tests/warm_up.py
	NUMBA_DISABLE_JIT=1 $(BIN)/coverage run tests/test_uncompiled.py build/coverage/numbers.npz
	NUMBA_DISABLE_JIT=1 $(BIN)/coverage run -m pytest -n auto --maxprocesses 4 -m "not slow" -W ignore::RuntimeWarning $(UNCOMPILED)
	$(BIN)/coverage run -m pytest -n auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder $(COVERAGE_TESTS) $(PYTEST_OPTIONS)
	$(BIN)/coverage combine --quiet
	$(BIN)/coverage html --quiet --fail-under 0
	$(BIN)/coverage report

# Speed beside an earlier commit, in turn on this machine: some ten minutes with nothing else running.
bench-check: $(VENV)/.installed $(VENV)/.learning
	$(BIN)/python tests/bench/check.py --base $(BASE) $(BENCH_OPTIONS)

# The type checker sees the packages where a wheel has them.
lint: $(VENV)/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	rm -rf build/typed/sayd_env && mkdir -p build/typed/sayd_env
	ln -s "$(CURDIR)"/sayd_env/* "$(CURDIR)"/agents "$(CURDIR)"/baselines build/typed/sayd_env
	cd build/typed && "$(CURDIR)"/$(BIN)/mypy --config-file ../../pyproject.toml
	if command -v actionlint; then actionlint; else echo "no actionlint here: the workflows are not checked"; fi

# What a release would upload: a source distribution, and the wheel that is built from it. The wheel works by itself.
dist: $(VENV)/.release
	rm -rf dist build/released
	$(BIN)/python -m build --no-isolation --outdir dist
	$(BIN)/twine check --strict dist/*
	$(BIN)/python -m venv build/released
	build/released/bin/python -m pip install --quiet --constraint constraints.txt dist/*.whl
	cd build/released && bin/sayd --version && bin/sayd policies

clean:
	rm -rf $(VENV) build dist sayd_env.egg-info .pytest_cache .mypy_cache .ruff_cache

# PYTHON names the interpreter; without it the first of these that is new enough serves.
# setuptools comes first and from the constraints: a build in isolation would fetch the newest one.
# An environment that works is brought up to date and not cleared: a study may be running in it.
$(VENV)/.installed: pyproject.toml constraints.txt
	@set -e; \
	for python in $(if $(PYTHON),"$(PYTHON)",python3.11 python3 python3.12 python3.13 python); do \
	  if "$$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then found=$$python; break; fi; \
	done; \
	if [ -z "$${found:-}" ]; then \
	  echo "make: Python 3.11 or newer is needed; name one with make PYTHON=/path/to/python3.11" >&2; exit 1; \
	fi; \
	if [ -n "$(PYTHON)" ] || ! $(BIN)/python -c '' 2>/dev/null; then "$$found" -m venv --clear $(VENV); fi; \
	echo "Installing into $(VENV) ($$($(BIN)/python --version 2>&1)), a minute or two"; \
	$(BIN)/python -m pip install --quiet --constraint constraints.txt setuptools; \
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --no-build-isolation --editable '.[test,lint]'; \
	touch $@

# The learning part, with torch, and the two clusters are what the tests need besides. pip's options choose torch's build:
# make test PIP_EXTRA_INDEX_URL=https://download.pytorch.org/whl/cpu
$(VENV)/.learning: $(VENV)/.installed
	@echo "Adding what the tests need besides (torch, Ray, Dask), a few minutes"
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --no-build-isolation --editable '.[train,onnx,ray,dask]'
	touch $@

# moviepy asks for an older Pillow and RLlib for an older Gymnasium. Both work with the tested ones, so what else they need
# is fetched by name.
$(VENV)/.clients: $(VENV)/.learning
	@echo "Adding clients (TorchRL, skrl, RLlib, sb3-contrib) and what records videos, half a minute"
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --no-build-isolation --editable '.[clients,video]' \
	  decorator imageio proglog python-dotenv dm-tree lz4 ormsgpack tensorboardX
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --no-deps moviepy
	touch $@

$(VENV)/.coverage $(VENV)/.release: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --no-build-isolation --editable '.[$(subst .,,$(@F))]'
	touch $@

$(VENV)/.pages: $(VENV)/.installed
	@echo "Adding what the site and its tests need (MkDocs, Playwright), half a minute"
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --no-build-isolation --editable '.[docs,browser]'
	touch $@
