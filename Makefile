# Every target sets up .venv by itself; nothing needs to be installed beforehand but Python 3.11 or newer.
#
#   make demo  [SEED=7] [OUT=out/demo]       conceal an effect, seal it, diagnose, compare
#   make demo  DATA=recordings/ [OUT=...]    diagnose your own recordings instead
#   make test | test-slow | bench | clean
#   make docs                                run the code of the documentation, build it into build/site, check its links
#   make evidence [TABLES="loops bench"]     make the measured tables of the documentation anew, with the commit below each
#   make slice                               conceal a few effects under a fresh seed, diagnose, count
#
# torch is installed on its own before the rest so that the build chosen there (pip's own settings, or PIP_FLAGS, for
# instance an index of CPU-only builds) stays: the project never needs CUDA.

PYTHON    ?= python3
PIP_FLAGS ?=
SEED      ?=
DATA      ?=
OUT       ?= out/demo

VENV  := .venv
BIN   := $(VENV)/bin
PIP   := $(BIN)/python -m pip --disable-pip-version-check install -qq $(PIP_FLAGS) -c constraints.txt
DEV   := $(VENV)/.installed-dev
BENCH := $(VENV)/.installed-bench
SITE  := $(VENV)/.installed-docs
# What the build of the documentation writes beside its sources.
BUILT := docs/effects docs/drawn docs/notebooks docs/api/generated docs/sg_execution_times.rst

.DEFAULT_GOAL := help
.PHONY: help demo test test-slow docs slice bench evidence clean
MAKEFLAGS += --no-print-directory
# OUT and DATA come from the environment of the recipes, so that a blank in a path does no harm.
export OUT DATA SEED

help:
	@sed -n 's/^#   //p' Makefile

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(f"Python {sys.version.split()[0]} is too old: set PYTHON= to 3.11 or newer" if sys.version_info < (3, 11) else 0)'
	@echo "making $(VENV)"
	@$(PYTHON) -m venv $(VENV)

$(DEV): pyproject.toml setup.py constraints.txt | $(BIN)/python
	@echo "installing phnn and its tools into $(VENV) (a few minutes the first time)"
	@$(PIP) "$$(grep '^torch==' constraints.txt)"
	@$(PIP) -e '.[dev]'
	@touch $@

$(BENCH): $(DEV)
	@echo "installing the benchmark's peers into $(VENV)"
	@$(PIP) -e '.[dev,bench]'
	@touch $@

$(SITE): $(DEV)
	@echo "installing what builds the documentation into $(VENV)"
	@$(PIP) -e '.[dev,docs]'
	@touch $@

demo: $(DEV)
	@if [ -n "$$DATA" ]; then \
		exec $(BIN)/phnn diagnose "$$DATA" --out "$$OUT"; \
	else \
		exec $(BIN)/phnn demo $${SEED:+--seed "$$SEED"} --out "$$OUT"; \
	fi

# As many tests at once as there are cores, one thread each, those of a file together: they share what they have made.
# While a worker compiles a kernel, others wait for it. Bytecode is kept whatever the surroundings say, or every worker
# and every process that a test starts would compile all modules.
test: $(DEV)
	@find phnn -name '*.py' | xargs cat | wc -l | xargs printf 'phnn: %s lines'
	@printf ' in %s files and %s folders\n' $$(find phnn -name '*.py' | wc -l) $$(find phnn -name '*.py' -printf '%h\n' | sort -u | wc -l)
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy
	@PYTHONDONTWRITEBYTECODE= OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --dist loadfile

test-slow: $(DEV)
	@$(BIN)/python -m pytest -m slow

# Without a network. Warnings are errors; the code of every page has to run and to print what the page says.
docs: $(SITE)
	@rm -rf build/site build/doctrees $(BUILT)
	@OMP_NUM_THREADS=1 $(BIN)/python docs/_ext/blocks.py
	@OMP_NUM_THREADS=1 $(BIN)/python -m sphinx -q -W --keep-going -j auto -b html -d build/doctrees docs build/site
	@$(BIN)/python docs/_ext/links.py build/site
	@echo "open build/site/index.html"

# Each run in a folder of its own: a proof goes on where it finds an earlier one.
slice: $(DEV)
	@OMP_NUM_THREADS=1 $(BIN)/python scripts/slice.py out="$$(mktemp -d)"

bench: $(BENCH)
	@$(BIN)/python -m benchmarks

# Hours; a stage that was cut off goes on.
evidence: $(BENCH)
	@$(BIN)/python scripts/evidence.py run $(TABLES)

clean:
	@rm -rf $(VENV) .mypy_cache .pytest_cache .ruff_cache build phnn.egg-info $(BUILT)
