# Two commands for users: make demo, make test. The rest is for developers.
# On Windows run them from Git Bash: the recipes use its mkdir, touch and rm.
ifeq ($(OS),Windows_NT)
PYTHON ?= python
BIN = $(VENV)/Scripts
else
PYTHON ?= python3
BIN = $(VENV)/bin
endif
VENV ?= .venv
OUT ?= demo_out
BLIND_CASES ?= 160
SAMPLES := sample_logs
# One encoding everywhere, whatever the system's own is.
export PYTHONUTF8 := 1
# Files of tests stay whole: what their tests share is made once.
SPREAD := -n 2 --dist loadfile

.PHONY: demo test check-all lowest lint types bench blind coverage faults mutants evidence samples pictures docs reproduction hooks \
    clean

demo: $(VENV)/.ready
	mkdir -p $(OUT)
	$(BIN)/swimid fit-drag $(SAMPLES)/rig/trials.yaml -o $(OUT)/drag.yaml
	$(BIN)/swimid fit-propulsion $(SAMPLES)/cruise/trials.yaml --drag $(OUT)/drag.yaml -o $(OUT)/propulsion.yaml
	$(BIN)/swimid fit-graybox $(SAMPLES)/tfish/trials.yaml -o $(OUT)/tfish.yaml
	$(BIN)/swimid compare $(SAMPLES)/tfish/trials.yaml --params $(OUT)/tfish.yaml -o $(OUT)/comparison.yaml
	$(BIN)/swimid diagnose $(SAMPLES)/gap/trials.yaml --params $(SAMPLES)/gap/params.yaml -o $(OUT)/gap.yaml
	$(BIN)/swimid simulate --params $(OUT)/tfish.yaml --frequency-hz 1 --amplitude-deg 20 --duration-s 15 -o $(OUT)/sim.csv
	$(BIN)/swimid rwls $(SAMPLES)/longfin/longfin_marching.csv --input cmd1_rad --output u_m_s --na 4 --nb 3 \
	    --weight 0.95 --validate $(SAMPLES)/longfin/longfin_validation.csv -o $(OUT)/arma.yaml
	$(BIN)/swimid track video $(SAMPLES)/pool/pool.mp4 --setup $(SAMPLES)/pool/pool_setup.yaml -o $(OUT)/run.csv \
	    --overlay $(OUT)/overlay.mp4 --force
	$(BIN)/swimid report $(OUT)/drag.yaml $(OUT)/propulsion.yaml $(OUT)/tfish.yaml $(OUT)/comparison.yaml \
	    $(OUT)/gap.yaml $(OUT)/arma.yaml $(OUT)/run.csv -o $(OUT)/report.html
	@echo "open $(OUT)/report.html"

test: $(VENV)/.ready-dev
	$(BIN)/python -m pytest $(SPREAD)

# Everything: long checks, lint, types, kernels with bounds checking.
check-all: $(VENV)/.ready-dev lint types
	$(BIN)/python -m pytest $(SPREAD) -m ""
	NUMBA_BOUNDSCHECK=1 NUMBA_CACHE_DIR=.numba_cache/bounds $(BIN)/python -m pytest $(SPREAD) -m "kernels"

# The tests with the lowest versions that pyproject.toml declares.
lowest:
	$(PYTHON) -m venv $(VENV)-lowest
	$(VENV)-lowest/bin/python -m pip install --quiet uv
	$(VENV)-lowest/bin/uv pip install --quiet --python $(VENV)-lowest/bin/python --resolution lowest-direct -e ".[dev]"
	$(VENV)-lowest/bin/python -m pytest $(SPREAD)

lint: $(VENV)/.ready-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.ready-dev
	$(BIN)/mypy

# Lint, format and types before every commit.
hooks: $(VENV)/.ready-dev
	$(BIN)/pre-commit install

bench: $(VENV)/.ready-bench
	for script in benchmarks/bench_*.py; do PYTHONPATH=. $(BIN)/python $$script || exit 1; done

# Diagnoses trials with hidden causes, made without swimid, by the command line; a run is taken up again.
blind: $(VENV)/.ready-dev
	$(BIN)/python -m validation.blind --cases $(BLIND_CASES) --out $(OUT)/blind

# Attacks every reader and output: damaged and hostile inputs, full disks, signals, two processes at once.
faults: $(VENV)/.ready-dev
	$(BIN)/python -m validation.faults

# Coverage of the stated intervals and false alarms of the checks, on simulated recordings of independent code.
coverage: $(VENV)/.ready-dev
	$(BIN)/python -m validation.coverage

# Small errors put into the package on purpose: the share that the tests notice. A run is taken up again.
mutants: $(VENV)/.ready-dev
	$(BIN)/python -m validation.mutants

# Prints all measured evidence from docs/measured, and writes its tables into the pages.
evidence: $(VENV)/.ready-dev
	$(BIN)/python -m docs.evidence

# Makes the files in sample_logs anew; they are seeded, so nothing changes unless the generators do.
samples: $(VENV)/.ready-dev
	$(BIN)/python -m tests.generators.make_samples

# The pictures of the manuals, from the sample logs.
pictures: $(VENV)/.ready-dev
	$(BIN)/python docs/pictures.py
	$(BIN)/python -m tests.pick_page docs/figures/pick.png

# The documentation site, in site/: pages of docs, reference from the code, the pictures that are drawn quickly.
docs: $(VENV)/.ready-docs
	$(BIN)/python docs/make_site.py

# The published figures of the built-in multi-link robots, and the twin of the dolphin: one page.
reproduction: $(VENV)/.ready-dev
	$(BIN)/python docs/reproduction.py > docs/reproduction.md.part
	echo >> docs/reproduction.md.part
	PYTHONPATH=. $(BIN)/python benchmarks/bench_tuning.py >> docs/reproduction.md.part
	mv docs/reproduction.md.part docs/reproduction.md

$(VENV)/.ready: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	touch $@

$(VENV)/.ready-dev: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[dev]"
	touch $(VENV)/.ready $@

$(VENV)/.ready-bench: $(VENV)/.ready-dev
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[bench]"
	touch $@

$(VENV)/.ready-docs: $(VENV)/.ready
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[docs]"
	touch $@

clean:
	rm -rf $(VENV) $(OUT) .pytest_cache .mypy_cache .ruff_cache .hypothesis .numba_cache .cache build site
