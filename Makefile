# Everything runs in .venv, which is created here and reused.
#   make demo      a closed-mouth smile on the shipped head, into out/
#   make test      the quick tests (a few minutes); test-all runs the slow ones too
#   make tutorial  from a T1 image to a smile, as docs/tutorial.md has it
#   make lint      style and types
#   make bench     times of assembly, factorisation and whole expressions
#   make peers     the same problems in other programs, side by side
#   make docs      the documentation, into docs/_build/html

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
OUT ?= out

.DEFAULT_GOAL := help
.PHONY: help demo test test-all tutorial lint bench peers docs clean

help:
	@sed -n 's/^#   //p' Makefile

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "make: $(PYTHON) is older than Python 3.11; name another with make PYTHON=..." >&2; exit 2; }
	@echo "Creating $(VENV)"
	@$(PYTHON) -m venv $(VENV)

# One stamp for each set of dependencies: installed again only when pyproject.toml changes.
$(VENV)/.installed-core: pyproject.toml | $(BIN)/python
	@echo "Installing modiolus into $(VENV) (a few minutes the first time)"
	@.ci/pip-install $(BIN)/python -e .
	@echo "Compiling its kernels (half a minute)"
	@out=$$(mktemp -d) && $(BIN)/modiolus simulate --activation mentalis=0.05 --quiet --out $$out >/dev/null \
		&& rm -r $$out
	@touch $@

$(VENV)/.installed-dev: pyproject.toml | $(VENV)/.installed-core
	@echo "Installing the test tools"
	@.ci/pip-install $(BIN)/python -e '.[dev]'
	@touch $@

$(VENV)/.installed-docs: pyproject.toml | $(VENV)/.installed-core
	@echo "Installing the documentation tools"
	@.ci/pip-install $(BIN)/python -e '.[docs]'
	@touch $@

demo: $(VENV)/.installed-core
	@$(BIN)/modiolus simulate smile-closed --out $(OUT)

test: $(VENV)/.installed-dev
	@$(BIN)/python -m pytest

test-all: $(VENV)/.installed-dev
	@$(BIN)/python -m pytest -m "slow or not slow"

# Of pydeface only an image is used: what it depends on is not installed.
tutorial: $(VENV)/.installed-dev
	@$(BIN)/python -c 'import importlib.util as u, sys; sys.exit(u.find_spec("pydeface") is None)' \
		|| .ci/pip-install $(BIN)/python --no-deps 'pydeface>=2.1'
	@$(BIN)/python -m pytest -s -m slow tests/test_tutorial.py

lint: $(VENV)/.installed-dev
	@$(BIN)/ruff check
	@$(BIN)/ruff format --check
	@$(BIN)/mypy

bench: $(VENV)/.installed-core
	@$(BIN)/modiolus bench

peers: $(VENV)/.installed-core
	@$(BIN)/python benchmarks/peers/run.py

docs: $(VENV)/.installed-docs
	@$(BIN)/sphinx-build --fail-on-warning --keep-going -q -b html docs docs/_build/html
	@echo "docs/_build/html/index.html"

clean:
	rm -rf $(OUT) docs/_build docs/_generated .mypy_cache .pytest_cache .ruff_cache
