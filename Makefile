# Needs only Python 3.11 (with venv) and make. Everything else goes into .venv.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
# One more than cores, since some tests wait for other programs.
WORKERS ?= 4
# Tests start hundreds of processes; each would compile our modules anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo line test quick check mypy pyright rules docs format generate bench prove soak requirements clean

demo: $(VENV)/.run
	$(BIN)/mdms demo

# A plant to look at: a table in a line, with its page.
line: $(VENV)/.run
	$(BIN)/python examples/line/plant.py

# Tests that keep pace with the machine's clock wait most of the time, so two go beside each other.
test: $(VENV)/.dev
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadgroup -m "not real_time"
	$(BIN)/python -m pytest -n 2 --dist loadgroup -m real_time

quick: $(VENV)/.dev
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadgroup -m "not slow and not real_time"

# Three parts, so that `make --jobs 2 check` has two beside each other.
check: mypy pyright rules

mypy: $(VENV)/.dev
	$(BIN)/mypy

pyright: $(VENV)/.dev typings/.installed
	$(BIN)/pyright --project firmware/pyrightconfig.json

rules: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python -m mdms_protocol.generators.generate --check
	$(BIN)/python -m mdms_host.cli.reference_pages --check
	$(BIN)/eds-validate protocol/mdms-cell.eds
	$(BIN)/dcfchk -n 1 protocol/mdms-cell.eds
	$(BIN)/lint-imports

# The site, into build/docs/index.html. It needs no network once its packages are there.
docs: $(VENV)/.docs
	$(BIN)/python -m sphinx -b html -W --keep-going -q -c docs . build/docs

format: $(VENV)/.dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

generate: $(VENV)/.dev
	$(BIN)/python -m mdms_protocol.generators.generate
	$(BIN)/python -m mdms_host.cli.reference_pages

bench: $(VENV)/.bench
	$(BIN)/python -m tests.benchmarks

# Right of way, explored to closure: minutes to an hour. Some of it: make prove PROVE="'2 x 2'".
prove: $(VENV)/.dev
	$(BIN)/python -m tests.prove $(PROVE)

# A night: twelve simulated hours of a cell. On the others: make soak SOAK="--nodes cpython".
soak: $(VENV)/.dev
	$(BIN)/python -m tests.soak $(SOAK)

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

# Each stamp names the set of packages that is in the environment; a larger set includes the smaller.
$(VENV)/.run: requirements/run.txt pyproject.toml | $(VENV)/bin/python
	$(PIP) install --quiet --no-compile --require-hashes -r requirements/run.txt
	$(PIP) install --quiet --no-deps --no-build-isolation --editable .
	@touch $@

$(VENV)/.dev: requirements/dev.txt $(VENV)/.run
	$(PIP) install --quiet --require-hashes -r requirements/dev.txt
	@touch $@

$(VENV)/.bench: requirements/bench.txt $(VENV)/.dev
	$(PIP) install --quiet --require-hashes -r requirements/bench.txt
	@touch $@

$(VENV)/.docs: requirements/docs.txt $(VENV)/.run
	$(PIP) install --quiet --require-hashes -r requirements/docs.txt
	@touch $@

# The stubs shadow modules of the standard library, so they live beside the environment, not in it.
typings/.installed: requirements/stubs.txt | $(VENV)/bin/python
	$(PIP) install --quiet --no-deps --require-hashes --upgrade --target typings -r requirements/stubs.txt
	@touch $@

# Needs uv; the files it writes are all that anybody else needs.
requirements:
	uv pip compile --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-annotate --no-header -q pyproject.toml --extra sim --extra page --group build -o requirements/run.txt
	uv pip compile --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-annotate --no-header -q pyproject.toml --extra sim --extra page --extra sweep --extra cluster --extra tune --extra learn --extra opcua --group build --group dev -c requirements/run.txt -o requirements/dev.txt
	uv pip compile --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-annotate --no-header -q pyproject.toml --extra sim --extra page --extra sweep --extra cluster --extra tune --extra learn --extra opcua --group build --group dev --group bench -c requirements/dev.txt -o requirements/bench.txt
	uv pip compile --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-annotate --no-header -q pyproject.toml --extra sim --extra page --group build --group docs -c requirements/dev.txt -o requirements/docs.txt
	uv pip compile --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-annotate --no-header -q --group stubs -o requirements/stubs.txt

clean:
	rm -rf $(VENV) typings build runs .pytest_cache .mypy_cache .ruff_cache .import_linter_cache
