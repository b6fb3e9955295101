# `make demo` and `make test` are all a newcomer needs; both make .venv first.
PYTHON ?= python3
PIP_FLAGS ?=
PY := .venv/bin/python

# Without --no-compile pip makes bytecode of every file of torch and SciPy, one after the other;
# Python does so itself for the few that are imported.
PIP := $(PY) -m pip install --quiet --disable-pip-version-check --no-compile $(PIP_FLAGS) -c constraints.txt
# Packages from the registry come while others are copied and C++ compiles.
MAKEFLAGS += -j2

.PHONY: install demo test check clean
install: .venv/installed .venv/tools viewer/node_modules/.installed

# What the program needs to run, which is all that the demo waits for.
.venv/installed: pyproject.toml constraints.txt CMakeLists.txt $(wildcard src/gsynopsis/_native/*)
	$(PYTHON) -m venv .venv
	$(PIP) torch
	$(PIP) -e '.[train,stream,serve,plots]'
	touch $@

# What its tests need beyond that: the extras `dev` and `docs`, without building the program again.
.venv/tools: .venv/installed
	$(PIP) $$($(PY) -c "import tomllib; \
		extras = tomllib.load(open('pyproject.toml', 'rb'))['project']['optional-dependencies']; \
		print(*extras['dev'], *extras['docs'])")
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

demo: .venv/installed
	.venv/bin/gsynopsis demo --out runs/demo

test: install
	PATH="$(CURDIR)/.venv/bin:$$PATH" scripts/check

check: test

clean:
	rm -rf .venv build runs viewer/node_modules
