# Each target does its own set-up: a virtual environment in .venv with everything installed.

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
DEMO_SOURCE ?= synthetic
DEMO_OUT ?= demo_out
DEMO_OPTIONS ?=
PYTEST_WORKERS ?= 2
UV ?= uv
# Tests run each of their many programs a few times: programs that compile fast suit them better than fast ones.
# Where a test is about XLA's defaults, or about the last digits of float64, it asks for them itself.
TEST_XLA_FLAGS ?= --xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false \
	--xla_cpu_parallel_codegen_split_count=1
# What one worker has compiled, the other and the next run need not. Keeping a program takes less time than
# compiling the smallest.
TEST_CACHE = JAX_COMPILATION_CACHE_DIR="$${JAX_COMPILATION_CACHE_DIR:-$(abspath $(VENV))/test_programs}" \
	JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS=0

.PHONY: demo test lint types imports docs bench lock audit clean

demo: $(VENV)/.installed
	$(BIN)/sfgs-jax run $(DEMO_SOURCE) --out $(DEMO_OUT) --overwrite $(DEMO_OPTIONS)

test: $(VENV)/.installed $(if $(filter true,$(CI)),$(VENV)/.installed-browser)
	XLA_FLAGS="$$XLA_FLAGS $(TEST_XLA_FLAGS)" $(TEST_CACHE) $(BIN)/pytest -n $(PYTEST_WORKERS)

lint: $(VENV)/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.installed
	$(BIN)/pyright

imports: $(VENV)/.installed
	$(BIN)/lint-imports
	$(BIN)/pytest tests/test_public_names.py

docs: $(VENV)/.installed
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

bench: $(VENV)/.installed
	$(BIN)/python -m benchmarks.gate

# Two steps, since pip can't hold an editable installation to hashes: all that the package needs, then itself.
$(VENV)/.installed: pyproject.toml requirements.lock
	@$(PYTHON) -c 'import sys; sys.exit("Python 3.11.5 or newer is needed, this is " + sys.version.split()[0]) if sys.version_info < (3, 11, 5) else None'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --requirement requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	touch $@

# After a change of dependencies or of constraints.txt; needs uv (https://docs.astral.sh/uv).
lock:
	$(UV) pip compile pyproject.toml --extra dev --extra docs --constraint constraints.txt --generate-hashes \
		--universal --python-version 3.11.5 --no-header --no-annotate --quiet --output-file requirements.lock

# Asks the network for known vulnerabilities, so it is no part of .ci/run.
audit:
	$(UV) tool run pip-audit --strict --disable-pip --require-hashes --requirement requirements.lock

# The viewer's pages are tested in a browser. It comes from Debian's packages, so only root can install it.
$(VENV)/.installed-browser:
	@for name in chromium chromium-browser google-chrome google-chrome-stable chrome; do \
		if command -v $$name; then exit 0; fi; \
	done; \
	if [ "$$(id -u)" != 0 ]; then echo "no browser is installed, and only root can install one"; exit 0; fi; \
	apt-get update --quiet=2 && \
	DEBIAN_FRONTEND=noninteractive apt-get install --quiet=2 --yes --no-install-recommends chromium
	mkdir -p $(VENV) && touch $@

clean:
	rm -rf $(VENV) site $(DEMO_OUT)
