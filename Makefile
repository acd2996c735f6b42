# Two commands do everything on a machine with Python >= 3.11, make and a C library:
#   make demo    make test
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

.PHONY: demo test test-slow test-lowest fuzz dist docs lint types format proto clean

$(READY): pyproject.toml requirements.lock
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c requirements.lock -e '.[dev]'
	touch $@

demo: $(READY)
	rm -rf demo-out
	$(BIN)/slam demo --out demo-out

test: $(READY)
	$(BIN)/python -m pytest -q -n 2 --dist loadfile -m 'not slow'

test-slow: $(READY)
	$(BIN)/python -m pytest -q -m slow

# With the oldest versions that pyproject.toml allows, in an environment of its own.
LOWEST := .venv-lowest
test-lowest:
	test -x $(LOWEST)/bin/python || $(PYTHON) -m venv $(LOWEST)
	$(LOWEST)/bin/python tests/lowest_versions.py pyproject.toml > $(LOWEST)/lowest.txt
	$(LOWEST)/bin/python -m pip install --quiet --disable-pip-version-check -c $(LOWEST)/lowest.txt -e '.[dev]'
	$(LOWEST)/bin/python -m pytest -q -n 2 --dist loadfile -m 'not slow'

# Wheel and source archive; the wheel is then installed into an empty environment and runs the demo.
dist: $(READY)
	rm -rf dist build .venv-dist
	$(BIN)/python -m build --outdir dist
	$(PYTHON) -m venv .venv-dist
	.venv-dist/bin/python -m pip install --quiet --disable-pip-version-check -c requirements.lock "$$(ls dist/*.whl)[live]"
	cd .venv-dist && bin/slam demo --direct --out demo-out
	rm -rf build .venv-dist

# Optional: looks for inputs that break the parsers of what devices send, and the log reader.
fuzz: $(READY)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c requirements.lock -e '.[fuzz]'
	$(BIN)/python tests/drivers/fuzz_parsers.py -max_total_time=120 -max_len=4096
	$(BIN)/python tests/logs/fuzz_reader.py -max_total_time=120 -max_len=512

lint: $(READY) types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# The package as it is installed, `slam` with the folders beside it inside, for mypy and editors.
types:
	rm -rf .types
	mkdir -p .types/slam
	ln -s $(addprefix ../../,$(wildcard slam/*) drivers frontend backend logs) .types/slam/
	ln -s ../benchmarks .types/benchmarks

# The documentation as a site; opens from the folder, loads nothing from elsewhere.
docs: $(READY)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c requirements.lock -e '.[docs]'
	$(BIN)/python -m slam.cli.config_reference > docs/configuration.md
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict
	@echo "open site/index.html; for its search: $(BIN)/python -m http.server -d site"

format: $(READY)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# The compiled form of the log's messages; a test compares it with its source.
proto: $(READY)
	$(BIN)/python -m grpc_tools.protoc -I logs --descriptor_set_out=logs/slam.binpb logs/slam.proto

clean:
	rm -rf $(VENV) $(LOWEST) .venv-dist build dist site .types demo-out bench-out .pytest_cache .mypy_cache .ruff_cache
