# `make demo` and `make test` are all a newcomer needs; both make .venv first.
PYTHON ?= python3
PIP_FLAGS ?=
PY := .venv/bin/python

.PHONY: install demo test check clean
install: .venv/installed

.venv/installed: pyproject.toml constraints.txt CMakeLists.txt $(wildcard src/gsynopsis/_native/*)
	$(PYTHON) -m venv .venv
	$(PY) -m pip install --quiet --disable-pip-version-check $(PIP_FLAGS) -c constraints.txt torch
	$(PY) -m pip install --quiet --disable-pip-version-check $(PIP_FLAGS) -c constraints.txt -e '.[train,stream,serve,plots,dev]'
	touch $@

demo: install
	.venv/bin/gsynopsis demo --out runs/demo

test: install
	PATH="$(CURDIR)/.venv/bin:$$PATH" scripts/check

check: test

clean:
	rm -rf .venv build runs
