# touchfield: everything runs in .venv; nothing is installed elsewhere.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: demo test bench lint gallery site reproduction golden core clean

demo: .venv/ready
	$(BIN)/touchfield demo demo

# Two processes, each with its own cache of compiled kernels: they must not write into one at a time.
test: .venv/ready
	@mkdir -p .beside
	@NUMBA_CACHE_DIR=$(CURDIR)/.beside $(BIN)/python -m pytest -p no:cacheprovider tests/*/ tests/test_[a-d]*.py > .beside/told.txt 2>&1 & \
	beside=$$!; $(BIN)/python -m pytest tests/test_[!a-d]*.py; here=$$?; wait $$beside; there=$$?; cat .beside/told.txt; \
	test $$here -eq 0 && test $$there -eq 0

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

# the decoder in C as a module of Python, built with a C compiler (core/README.md)
core: .venv/ready
	$(BIN)/python -m pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir core/dist ./core
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --force-reinstall core/dist/touchfield_core-*.whl

.venv/ready: requirements.lock pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "touchfield needs Python 3.11 or newer; name one with: make PYTHON=python3.12")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	touch .venv/ready

clean:
	rm -rf .venv .beside demo site
