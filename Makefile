# touchfield: everything runs in .venv; nothing is installed elsewhere.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: demo module test test-thorough test-all bench lint gallery site reproduction golden wheels release rehearsal version web browser-tests clean

demo: .venv/ready
	$(BIN)/touchfield demo demo

# Two processes side by side, over one cache of compiled kernels. Threads of linear algebra would only take turns, and
# a hundred interpreters that are started would each compile the modules where none may keep them.
SECOND := $(addprefix tests/,cli codec conformance exchange pipeline render)
FIRST := $(filter-out $(SECOND) tests/plugin tests/__pycache__,$(patsubst %/,%,$(wildcard tests/*/))) $(wildcard tests/test_*.py)
test: .venv/ready
	@export OPENBLAS_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE=; output=$$(mktemp); \
	$(BIN)/python -m pytest -m "not thorough and not external" -p no:cacheprovider $(SECOND) > $$output 2>&1 & \
	second=$$!; $(BIN)/python -m pytest -m "not thorough and not external" $(FIRST); first_status=$$?; \
	wait $$second; second_status=$$?; cat $$output; rm $$output; \
	test $$first_status -eq 0 && test $$second_status -eq 0

# What `make test` leaves out: the tests marked thorough or external, and every benchmark with its smallest settings.
test-all: test-thorough
	$(BIN)/python bench/run_all.py --quick

test-thorough: .venv/ready
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -m "thorough or external" tests

bench: .venv/ready
	$(BIN)/python bench/run_all.py

lint: .venv/ready
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports

gallery: .venv/ready
	MPLBACKEND=agg $(BIN)/python docs/gallery/build.py

site: .venv/ready
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

# the pages of docs/reproduction; DEPTH names depth sequences of one's own: make reproduction DEPTH="one two"
reproduction: .venv/ready
	MPLBACKEND=agg $(BIN)/python -m reproduction all --out docs/reproduction $(foreach folder,$(DEPTH),--depth $(folder))

# the only way in which golden files are written; a change in them is a change of the format
golden: .venv/ready
	$(BIN)/python conformance/make_golden.py
	$(BIN)/python conformance/make_queries.py

# wheels for the platforms of build_backend/targets.py, cross-compiled by zig, and checked
wheels: .venv/ready .venv/release
	$(BIN)/python build_backend/wheels.py dist

# all that a release publishes, built and checked in dist/; nothing is uploaded. See CONTRIBUTING.md
release: .venv/ready .venv/release
	$(BIN)/python build_backend/release.py dist

# the same before a release: what would forbid to publish dist/ is reported last
rehearsal: .venv/ready .venv/release
	$(BIN)/python build_backend/release.py dist --rehearsal

# a new version, in the places that state it: make version VERSION=0.2.0
version: .venv/packages
	$(BIN)/python build_backend/set_version.py '$(VERSION)'

# the page of `touchfield view`, built from web/ and c/; needs node, and npm's registry once
web: .venv/ready web/node_modules/.package-lock.json
	$(BIN)/python -c 'import ziglang' 2>/dev/null || $(BIN)/python -m pip install --quiet --disable-pip-version-check 'ziglang>=0.16'
	cd web && npm run check && PYTHON=$(CURDIR)/$(BIN)/python npm run build

# the page in a real browser: Debian's Chromium, installed where it can be
browser-tests: .venv/ready web/node_modules/.package-lock.json
	@command -v chromium > /dev/null || apt-get install -y chromium || echo 'no Chromium: apt-get install chromium'
	$(BIN)/python -m pytest -p no:cacheprovider tests/viewer

web/node_modules/.package-lock.json: web/package-lock.json
	cd web && npm ci --no-audit --no-fund

# the package, with its compiled module: again after its sources in C were edited
.venv/ready: .venv/packages pyproject.toml $(wildcard c/*.h c/python/* build_backend/*.py)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	touch .venv/ready

.venv/packages: requirements.lock
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "touchfield needs Python 3.11 or newer; name one with: make PYTHON=python3.12")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	@PYTHONPATH=build_backend $(BIN)/python -c 'import compiler; compiler.find_compiler()' 2> /dev/null || { \
	echo 'no C compiler here: ziglang from PyPI compiles the coder'; \
	$(BIN)/python -m pip install --quiet --disable-pip-version-check 'ziglang>=0.16'; }
	touch .venv/packages

# what builds and checks a release: the extra `release`
.venv/release: .venv/packages requirements-release.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements-release.lock
	touch .venv/release

# the compiled module again, as an error of its import asks for
module: .venv/packages
	rm -f .venv/ready
	$(MAKE) .venv/ready

clean:
	rm -rf .venv demo site web/node_modules
