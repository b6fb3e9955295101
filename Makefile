# `make demo` and `make test` are all a newcomer needs; both make .venv first.
PYTHON ?= python3
PIP_FLAGS ?=
PY := .venv/bin/python

# Without --no-compile pip makes bytecode of every file of torch and SciPy, one after the other;
# Python does so itself for the few that are imported.
PIP := $(PY) -m pip install --quiet --disable-pip-version-check --no-compile $(PIP_FLAGS) -c constraints.txt
# What the project asks for besides itself: its dependencies, and those of some extras.
REQUIRED = $$($(PY) -c "import sys, tomllib; \
	project = tomllib.load(open('pyproject.toml', 'rb'))['project']; \
	extras = project['optional-dependencies']; \
	print(*project['dependencies'], *(name for extra in sys.argv[1:] for name in extras[extra]))" $(1))
# Packages are copied while C++ compiles.
MAKEFLAGS += -j2

.PHONY: install demo test check clean
install: .venv/installed .venv/tools viewer/node_modules/.installed

.venv/made:
	$(PYTHON) -m venv .venv
	touch $@

# What the program needs to run, which is all that the demo waits for.
.venv/packages: pyproject.toml constraints.txt | .venv/made
	$(PIP) $(call REQUIRED,train stream serve plots)
	touch $@

.venv/kernels: pyproject.toml constraints.txt CMakeLists.txt $(wildcard src/gsynopsis/_native/*.* src/gsynopsis/_native/*/*.*) | .venv/made
	$(PIP) --no-deps -e .
	touch $@

.venv/installed: .venv/packages .venv/kernels
	touch $@

# What its tests need beyond that: the extras `dev` and `docs`.
.venv/tools: .venv/installed
	$(PIP) $(call REQUIRED,dev docs)
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
