# make demo   make the environment, run the main job on packaged demonstrations, name the report
# make test   lint, types, tests, among them that the documentation site builds without a warning
# make test-core [PYTHON=python3.13]   the environments alone, without what learns, on any Python
# make slow   the tests that take minutes
# make coverage   the tests of make test, and which lines none of them reached
# make results   the test split of every data set once more, three seeds, and the tables of
#             docs/results; hours, and goes on where it was interrupted
# make docs   the documentation site, in docs/_build/html; warnings are errors
# make mutants [MODULES=...] [SAMPLE=60]   which changes of the code no test notices
# make locks   constraints.txt with hashes, and what other systems need beside it, with uv
# make fuzz [N=20000] [M=10000] [SEED=0]   N damaged files through every reader, and M whole tables
#             whose meaning is known; see SECURITY.md
PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
PACKAGES := $(VENV)/.packages
CORE := .venv-core/bin/python
# Files of these folders that need what learns or draws.
NOT_CORE := $(addprefix --ignore=tests/envs/,test_compiling.py \
	views/test_view_specs.py worlds/test_executed_actions.py worlds/test_flock.py \
	worlds/test_plume.py worlds/test_senses.py)
LOCK := uv pip compile -q --universal --python-version 3.11.5 --generate-hashes --no-header \
	--no-annotate -c constraints.txt pyproject.toml
# Two files of tests at a time; the tests of one file share what they make.
PYTEST := $(BIN)/python -m pytest -q -n 2 --dist loadfile

# Tests start many programs: they would compile the project's files each time.
unexport PYTHONDONTWRITEBYTECODE

N ?= 20000
M ?= 10000
SEED ?= 0

.PHONY: demo results test test-core coverage slow docs locks mutants fuzz lint types kernels clean

demo: $(STAMP)
	$(BIN)/animarl run packaged --species agent --seed 0 --out out/demo

# The types take as long as the kernels, so both cores have work; tests then find kernels on disk.
test: $(PACKAGES)
	$(MAKE) --jobs=2 types lint kernels
	$(PYTEST) -m "not slow"

test-core:
	test -x $(CORE) || $(PYTHON) -m venv .venv-core
	$(CORE) -m pip install -q --disable-pip-version-check --require-hashes -r locks/core.txt
	$(CORE) -m pip install -q --disable-pip-version-check --no-deps -e .
	$(CORE) -m pytest -q -m "not slow" $(NOT_CORE) \
		tests/envs/views tests/envs/worlds tests/envs/wrappers tests/envs/test_*.py

coverage: $(STAMP)
	$(PYTEST) -m "not slow" --cov --cov-report=term:skip-covered

slow: $(STAMP)
	$(PYTEST) -m slow

results: $(STAMP)
	$(BIN)/python benchmarks/faithful.py --test --seed 0 --seed 1 --seed 2 --out docs/results/test
	$(BIN)/python docs/make_results_tables.py

docs: $(STAMP)
	$(BIN)/sphinx-build -W --keep-going -q -b html docs docs/_build/html

locks:
	$(LOCK) --group core -o locks/core.txt
	$(LOCK) --all-extras --group core --group lint -o locks/all.txt

mutants: $(STAMP)
	$(BIN)/python tools/mutants.py $(MODULES) $(if $(SAMPLE),--sample $(SAMPLE))

fuzz: $(STAMP)
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m tools.fuzz -n $(N) --seed $(SEED)
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m tools.fuzz --meanings $(M) --seed $(SEED)

lint: $(PACKAGES)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(PACKAGES)
	$(BIN)/mypy
	$(BIN)/mypy docs/*.py

kernels: $(PACKAGES)
	$(BIN)/animarl compile

clean:
	rm -rf $(VENV) .venv-core out build *.egg-info

# All modules are compiled at the end, on all cores.
QUIETLY := -q --disable-pip-version-check --no-compile

# torch comes first and by itself, so that no other package can ask for another build of it; which
# one stands in constraints.txt.
$(PACKAGES): pyproject.toml setup.cfg constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV) || python3 -m venv $(VENV)
	$(BIN)/python -m pip install $(QUIETLY) -c constraints.txt torch
	$(BIN)/python -m pip install $(QUIETLY) -c constraints.txt -e '.[all,docs]'
	$(BIN)/python -m compileall -qq -j 0 $(VENV)/lib || true  # some are templates, no Python
	touch $(PACKAGES)

# So that no first step of the checkout waits for a compiler.
$(STAMP): $(PACKAGES)
	$(MAKE) kernels
	touch $(STAMP)
