# Each target sets up .venv by itself, once; the stamp renews it when the dependencies change.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
NATIVE := build/native/.built
TYPES := build/.types
DEMO := build/demo

# Every command that a test starts would compile the package anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test test-all tests lowest mutants docs bench lint format lock cross wheels release-check clean

# What the commands say is kept beside the pages; their progress is shown.
demo: | progress $(NATIVE)
	@mkdir -p $(DEMO)
	@$(BIN)/gainroom example biped > $(DEMO)/biped.yaml
	@$(BIN)/gainroom example testbed > $(DEMO)/testbed.yaml
	@echo "A robot of 12 joints in 8 states, and the gains to use instead (half a minute) …"
	@$(BIN)/gainroom robot $(DEMO)/biped.yaml --exit-zero --report $(DEMO)/biped.html > $(DEMO)/biped.txt
	@echo "One joint, and all its stable gains …"
	@$(BIN)/gainroom joint $(DEMO)/testbed.yaml --exit-zero --report $(DEMO)/testbed.html > $(DEMO)/testbed.txt
	@echo "Open in a browser (beside each, what the terminal says as .txt):"
	@echo "  $(DEMO)/biped.html"
	@echo "  $(DEMO)/testbed.html"

# The first line, whatever there is to do before.
.PHONY: progress
progress:
	@echo "gainroom: a robot and a joint, each with a page; in a new clone first an environment and the C++ core (a few minutes) ..."

# Of the slow tests a thirtieth, with the next commit the next one: as many commits run all of them. `make test SHARE=K` runs share K.
SHARE = $(or $(shell git rev-list --count HEAD 2>/dev/null),0)

# Side by side, as types and documentation take one core half a minute.
test: $(NATIVE)
	@$(MAKE) --no-print-directory --jobs=2 tests lint docs SLOW="--share $(SHARE)"

# Every test but the populations, which `pytest -m population` runs.
test-all: $(NATIVE)
	@$(MAKE) --no-print-directory --jobs=2 tests lint docs

tests: $(NATIVE)
	$(BIN)/pytest -n 2 --dist worksteal -q $(SLOW)

# The quick tests with the oldest versions that pyproject.toml allows.
lowest: $(NATIVE)
	@scripts/lowest.sh $(VENV)

# One process, and up to two minutes for each mutant: an idle machine tries more tests in them.
mutants: $(NATIVE)
	$(BIN)/python scripts/mutants.py

lint: $(STAMP) $(TYPES)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python scripts/lint_javascript.py
	$(BIN)/python scripts/lint_shipping.py

# Half a minute, and nothing new to say of sources that have passed.
$(TYPES): $(STAMP) pyproject.toml $(shell find src -name '*.py' -o -name '*.pyi')
	$(BIN)/pyright
	@mkdir -p $(@D)
	@touch $@

# All of it every time, as pages that have not changed would not warn again.
docs: $(NATIVE)
	@rm -rf build/docs
	$(BIN)/sphinx-build -q -E -W --keep-going -d build/doctrees docs build/docs

format: $(STAMP)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(NATIVE)
	$(BIN)/python -m benchmarks --page docs/performance.md

$(STAMP): pyproject.toml requirements-dev.lock scripts/setup.sh
	@scripts/setup.sh $(VENV) $(PYTHON)
	@touch $@

# The C++ core, beside the Python that imports it.
$(NATIVE): $(STAMP) CMakeLists.txt scripts/native.sh $(shell find src/gainroom/native -name '*.[ch]pp')
	@scripts/native.sh $(VENV)
	@touch $@

# The C++ core for other processors and systems, as far as a compiler goes.
cross: $(STAMP)
	@$(BIN)/python scripts/cross_compile.py

# A source distribution, and a wheel that needs no compiler, in dist/.
wheels:
	@scripts/wheels.sh $(PYTHON)

# A release but for its publication: what `make wheels` built is checked, installed into an empty environment and run.
release-check: wheels
	@scripts/release_check.sh $(PYTHON)

# Newest versions that pyproject.toml allows, written down for everyone.
lock:
	rm -rf build/lock
	$(PYTHON) -m venv build/lock
	build/lock/bin/pip install -q --editable .[dev]
	build/lock/bin/pip freeze --exclude-editable --exclude pip --exclude setuptools > requirements-dev.lock

clean:
	rm -rf $(VENV) build dist .pytest_cache .ruff_cache .hypothesis src/gainroom/native/*.so
