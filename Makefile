# make demo   make the environment, run the main job on packaged demonstrations, name the report
# make test   lint, types, tests
# make slow   the tests that take minutes
# make coverage   the tests of make test, and which lines none of them reached
# make docs   the documentation site, in docs/_build/html; warnings are errors
# make mutants [MODULES=...] [SAMPLE=60]   which changes of the code no test notices
# make fuzz [N=20000] [SEED=0]   damaged files through every reader, see SECURITY.md
PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
# Two files of tests at a time; the tests of one file share what they make.
PYTEST := $(BIN)/python -m pytest -q -n 2 --dist loadfile

N ?= 20000
SEED ?= 0

.PHONY: demo test coverage slow docs mutants fuzz lint types clean

demo: $(STAMP)
	$(BIN)/animarl run packaged --species agent --seed 0 --out out/demo

test: $(STAMP) lint types
	$(PYTEST) -m "not slow"

coverage: $(STAMP)
	$(PYTEST) -m "not slow" --cov --cov-report=term:skip-covered

slow: $(STAMP)
	$(PYTEST) -m slow

docs: $(VENV)/.docs
	$(BIN)/sphinx-build -W --keep-going -q -b html docs docs/_build/html

mutants: $(STAMP)
	$(BIN)/python tools/mutants.py $(MODULES) $(if $(SAMPLE),--sample $(SAMPLE))

fuzz: $(STAMP)
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m tools.fuzz -n $(N) --seed $(SEED)

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(STAMP)
	$(BIN)/mypy
	$(BIN)/mypy docs/*.py

clean:
	rm -rf $(VENV) out build *.egg-info

# torch comes first and by itself, so that no other package can ask for another build of it; which
# one stands in constraints.txt.
$(STAMP): setup.cfg pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV) || python3 -m venv $(VENV)
	$(BIN)/python -m pip install -q --disable-pip-version-check -c constraints.txt torch
	$(BIN)/python -m pip install -q --disable-pip-version-check -c constraints.txt -e '.[all]'
	touch $(STAMP)

$(VENV)/.docs: $(STAMP)
	$(BIN)/python -m pip install -q --disable-pip-version-check -c constraints.txt -e '.[docs]'
	touch $@
