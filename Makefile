# make demo   identify the measured frame and write its report
# make test   run the quick tests (minutes)
# make test-all  run all tests, the long ones too (what .ci/run runs)
# make docs   build the documentation site
# make pictures  draw the picture of README and landing page from the demo's answer
# make fuzz   damage files of every kind and keys of studies, vary headers of records, and print what came of reading them (COUNT=20000 SEED=5 for more)
# make golden run every example with the code of BASE and of this tree: numbers must be equal, changed words are listed (BASE=HEAD~1)
# make benchmarks  run every benchmark at a size of seconds, to see that none rots
# make mutants make some 170 wrong edits of central formulas, one at a time in a copy: a quick test must fail for each (NAMES="fem mac")
# make killed end runs at 100 random moments and run them again to the same digits
# make dist-check   build wheel and sdist, check what PyPI shows of them, install them without extras outside the tree, run an example (needs PyPI)
# make test-lowest  run all tests on Python 3.11 with the lowest versions that pyproject.toml names (needs uv and 3.11)
# make test-newest  run all tests on Python 3.13 with the newest versions (needs uv and 3.13)
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

COUNT ?= 2000
SEED ?= 1
BASE ?= HEAD
NAMES ?=

# byte code is kept even where the environment says otherwise: the tests start the command hundreds of times
export PYTHONDONTWRITEBYTECODE =

.PHONY: pictures demo test test-all lint types imports check docs fuzz golden benchmarks killed mutants dist-check test-lowest test-newest clean

demo: $(STAMP)
	$(BIN)/structid identify examples/three_storey_frame/study.toml --out results/demo --workers 2

test: $(STAMP)
	OPENBLAS_NUM_THREADS=1 MPLBACKEND=Agg $(BIN)/python -m pytest -n 2 --dist worksteal

# the quick and the long tests in one run: nothing runs twice
test-all: $(STAMP)
	OPENBLAS_NUM_THREADS=1 MPLBACKEND=Agg $(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow"

# the page's JavaScript too, by biome.json, where node is there and the linter can be fetched (once; it is no part of structid)
BIOME := @biomejs/biome@2.6.8
lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	@if npx --yes $(BIOME) --version >/dev/null 2>&1; then npx --yes $(BIOME) check .; else echo "no node, or no way to fetch $(BIOME): the page's JavaScript is not linted"; fi

types: $(STAMP)
	$(BIN)/mypy

imports: $(STAMP)
	$(BIN)/lint-imports

check: test lint types imports

# a site that opens from disk, with search; warnings, links to nowhere and what axe-core calls serious are errors
docs: $(STAMP)
	$(BIN)/python -m pip install --quiet --editable ".[docs]"
	$(BIN)/python -m sphinx --quiet --fail-on-warning --keep-going -b html docs docs/_build/html
	$(BIN)/python docs/accessible.py docs/_build/html
	@echo docs/_build/html/index.html

pictures: $(STAMP)
	$(BIN)/python docs/demo_picture.py

fuzz: $(STAMP)
	$(BIN)/python -m fuzz --count $(COUNT) --seed $(SEED)
	$(BIN)/python -m fuzz.keys --count $(COUNT) --seed $(SEED)
	$(BIN)/python -m fuzz.headers --count $(COUNT) --seed $(SEED)
	$(BIN)/python -m fuzz.true_modes
	$(BIN)/python -m fuzz.true_decks

golden: $(STAMP)
	$(BIN)/python -m golden $(BASE) --reproduction

# each in a copy of the package, two at a time; NAMES are mutants or packages
mutants: $(STAMP)
	$(BIN)/python -m mutants $(NAMES)

# every benchmark at a size of seconds: that it runs, not what it measures
benchmarks: $(STAMP)
	$(BIN)/python benchmarks/small.py

killed: $(STAMP)
	$(BIN)/python -m fuzz.killed --count 100 --seed $(SEED)

# a clean environment outside the tree: what the package forgets to name or to hold shows here
dist-check: $(STAMP)
	$(BIN)/python -m pip install --quiet build twine
	rm -rf dist
	$(BIN)/python -m build --quiet --outdir dist .
	$(BIN)/python -m twine check --strict dist/*
	$(BIN)/python -m fuzz.dist_check dist

test-lowest:
	uv venv --quiet --clear --python 3.11 .venv-lowest
	uv pip install --quiet --python .venv-lowest/bin/python --resolution lowest-direct --editable ".[dev]"
	OPENBLAS_NUM_THREADS=1 MPLBACKEND=Agg .venv-lowest/bin/python -m pytest -n 2 --dist worksteal -m "not slow"

test-newest:
	uv venv --quiet --clear --python 3.13 .venv-newest
	uv pip install --quiet --python .venv-newest/bin/python --editable ".[dev]"
	OPENBLAS_NUM_THREADS=1 MPLBACKEND=Agg .venv-newest/bin/python -m pytest -n 2 --dist worksteal -m "not slow"

$(STAMP): pyproject.toml
	$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11) and 'structid needs Python 3.11 or newer, this is ' + sys.version)"
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --editable ".[dev]"
	touch $(STAMP)

clean:
	rm -rf $(VENV) docs/_build docs/reference docs/gallery .venv-lowest .venv-newest dist results .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
