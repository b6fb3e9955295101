# `make demo` and `make test` are all a newcomer needs; both make .venv first.
PYTHON ?= python3
PIP_FLAGS ?=
PY := .venv/bin/python

.PHONY: install demo test check clean
install: .venv/installed viewer/node_modules/.installed

.venv/installed: pyproject.toml constraints.txt CMakeLists.txt $(wildcard src/gsynopsis/_native/*)
	$(PYTHON) -m venv .venv
	$(PY) -m pip install --quiet --disable-pip-version-check $(PIP_FLAGS) -c constraints.txt torch
	$(PY) -m pip install --quiet --disable-pip-version-check $(PIP_FLAGS) -c constraints.txt -e '.[train,stream,serve,plots,dev]'
	touch $@

# The packages that build and test the viewer. Without npm or its registry the rest works all the same.
viewer/node_modules/.installed: viewer/package.json viewer/package-lock.json
	@if ! command -v npm >/dev/null; then \
		echo "npm is not installed: the viewer will NOT be tested in a browser"; \
	elif npm ci --prefix viewer --ignore-scripts --no-audit --no-fund --loglevel error --fetch-retries 1; then \
		touch $@; \
	else \
		echo "npm could not fetch the viewer's packages: the viewer will NOT be tested in a browser"; \
	fi

demo: install
	.venv/bin/gsynopsis demo --out runs/demo

test: install
	PATH="$(CURDIR)/.venv/bin:$$PATH" scripts/check

check: test

clean:
	rm -rf .venv build runs viewer/node_modules
