# Every target that needs Python makes .venv in this folder and builds the core into it; stamps keep a second call short.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
RUST := $(shell find rust -name "*.rs") $(wildcard Cargo.toml Cargo.lock rust/python/Cargo.toml pyproject.toml build.rs)

# cargo and maturin find the interpreter of .venv, whatever else is on the path.
export VIRTUAL_ENV := $(abspath $(VENV))
export PYO3_PYTHON := $(abspath $(BIN)/python)
export PIP_DISABLE_PIP_VERSION_CHECK := 1
# Compiled modules are kept: both processes of the tests, and each command that tests start, read them again.
export PYTHONDONTWRITEBYTECODE :=
# Material announces its successor in every build.
export NO_MKDOCS_2_WARNING := 1

.PHONY: help demo test test-slow test-tools test-pages test-machines coverage coverage-rust lint bench docs wheel sdist wheel-check clean
.NOTPARALLEL:
.DELETE_ON_ERROR:

help:
	@echo "make demo    the paper's experiment: all methods on a simulated TX40, beside the truth"
	@echo "make test    the Python tests but for the slow ones (the Rust tests are: cargo test --release)"
	@echo "make test-slow  tests of a second or more: whole real logs, many seeds, whole pages"
	@echo "make test-pages  pages in a real browser (Debian's chromium), screenshots in out/pages"
	@echo "make test-tools  tests of the programs in benches/ and of releases, which make test leaves out"
	@echo "make test-machines  the tests as other processors, other versions of NumPy and SciPy and a loaded machine run them (hours)"
	@echo "make coverage  which lines of the Python package the tests run; make coverage-rust: of the core"
	@echo "make lint    rustfmt, clippy, ruff, mypy and the stubs of the core"
	@echo "make bench   speed of the core, its instructions (where valgrind is installed), and speed beside other programs"
	@echo "make docs    the documentation, in site/"
	@echo "make wheel   a wheel for Linux of this processor, or of TARGET=aarch64-unknown-linux-gnu, with glibc 2.17 or later (manylinux), in dist/"
	@echo "make sdist   the sources, in dist/: pip makes a wheel of them where Rust is installed"
	@echo "make wheel-check   a wheel, and examples and demo with it in empty environments, without Rust"
	@echo "make clean   remove everything that the targets above made"

$(BIN)/maturin:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "didim needs Python 3.11 or later")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet 'pip>=25.1' 'maturin>=1.16,<2'

# Groups of pyproject.toml, with spaces between, that the first build installs while it compiles.
GROUPS ?=
# The package itself, editable: changed Python needs no new build, changed Rust does. What the compiler leaves of the processor
# installs NumPy, SciPy and GROUPS meanwhile; the second call installs the package that the first one built.
$(VENV)/.built: $(BIN)/maturin $(RUST)
	nice sh -c '$(BIN)/python -m pip install --quiet numpy scipy $(addprefix --group ,$(GROUPS)) \
		$(if $(GROUPS),&& touch $(addprefix $(VENV)/.group-,$(GROUPS)))' & \
	installing=$$!; $(BIN)/maturin develop --release --skip-install; built=$$?; wait $$installing && exit $$built
	$(BIN)/maturin develop --release
	@touch $@

# The dependency groups of pyproject.toml: .venv/.group-test and so on.
$(VENV)/.group-%: pyproject.toml | $(BIN)/maturin
	$(BIN)/python -m pip install --quiet --group $*
	@touch $@

demo: $(VENV)/.built
	$(BIN)/didim compare

test: $(VENV)/.built $(VENV)/.group-test
	$(BIN)/python -m pytest -n auto --dist loadfile -m 'not slow and not tools and not pages'

test-slow: $(VENV)/.built $(VENV)/.group-test
	$(BIN)/python -m pytest -n auto --dist worksteal -m slow

test-tools: $(VENV)/.built $(VENV)/.group-test
	$(BIN)/python -m pytest -n auto --dist loadfile -m tools

test-pages: docs $(VENV)/.group-test $(VENV)/.group-pages
	$(BIN)/python -m pytest -n auto --dist loadgroup -m pages

# One combination after the other; what this processor cannot run is skipped with a sentence.
test-machines: $(VENV)/.built $(VENV)/.group-test
	$(BIN)/python benches/machines.py

# Branches too; fails under the share in pyproject.toml.
coverage: $(VENV)/.built $(VENV)/.group-test
	$(BIN)/coverage erase
	$(BIN)/coverage run -m pytest
	$(BIN)/coverage combine --quiet
	$(BIN)/coverage report

# The flag leaves out inlining: kernels that are inlined everywhere, with a counter for each branch, do not come out of the compiler.
coverage-rust:
	RUSTFLAGS="-C no-prepopulate-passes" cargo llvm-cov --summary-only --fail-under-lines 90

lint: $(VENV)/.built $(VENV)/.group-test $(VENV)/.group-lint $(VENV)/.group-docs
	cargo fmt --all --check
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/python benches/constant_docstrings.py
	$(BIN)/python benches/function_sizes.py
	$(BIN)/python benches/lines.py --measures
	$(BIN)/mypy --strict
	$(BIN)/python -m mypy.stubtest didim._core
	cargo clippy --release --workspace --all-targets -- -D warnings

bench: $(VENV)/.built $(VENV)/.group-peers
	cargo bench
	cargo bench -- --instructions
	$(BIN)/python benches/peers.py

docs: $(VENV)/.built $(VENV)/.group-docs
	$(BIN)/mkdocs build --strict

# zig, a package of PyPI, links with the symbols of an old glibc: the wheel runs on systems older than this one. maturin asks the first
# python3 on the path for it. Neither the core nor the SBOM may tell where they were built: rustc writes the places of its sources, and
# maturin the folder of the project.
CARGO_HOME ?= $(HOME)/.cargo
wheel: $(VENV)/.group-wheels
	rm -rf dist/built
	PATH="$(abspath $(BIN)):$$PATH" \
	RUSTFLAGS="--remap-path-prefix=$(CARGO_HOME)/registry/src=crates --remap-path-prefix=$(CURDIR)=didim" \
	$(BIN)/maturin build --release --strip --zig $(addprefix --target ,$(TARGET)) --compatibility manylinux2014 --out dist/built
	$(BIN)/wheel unpack --dest dist/built dist/built/didim-*.whl
	sed -i 's|path+file://$(CURDIR)|path+file:///didim|g' dist/built/didim-*/*.dist-info/sboms/*.json
	$(BIN)/wheel pack --dest-dir dist $$(ls -d dist/built/didim-*/)
	rm -r dist/built

sdist: $(BIN)/maturin
	$(BIN)/maturin sdist --out dist

wheel-check: wheel
	$(BIN)/python benches/wheel_check.py

clean:
	rm -rf $(VENV) target dist site out .pytest_cache .mypy_cache .ruff_cache .hypothesis .coverage .coverage.*
	rm -f python/didim/*.so
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
