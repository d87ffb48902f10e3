# polarfield: `make all CAPTURE=folder`; `make help` lists the rest.
PYTHON ?= python3
VENV ?= .venv
DEVICE ?= auto
JOBS ?= 1
DEMO ?= build/demo
STAGES := decode poses masks olat train mesh relight metrics
BENCHES := $(addprefix bench-,approximations mesh rasterize shading decode masks olat overexposure train light ablation assets poses)

# A misspelt variable would be ignored without a word.
VARIABLES := CAPTURE DATASET PARAMS ENVS DEVICE JOBS DRY_RUN YES FULL REPAIR CAPTURES MEMORY PYTHON VENV DEMO
$(foreach name,$(.VARIABLES),$(if $(filter command,$(origin $(name))),$(if $(filter-out $(VARIABLES) MAKE% -%,$(name)),\
  $(error $(name)= is not a variable of this Makefile; it knows $(VARIABLES:%=%=)))))

# Values are what the user wrote: make itself would expand a $ in them.
$(foreach name,$(VARIABLES),$(eval override $(name) := $$(value $(name))))
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
READY := $(VENV)/.ready

# Through the environment, so that the shell takes every value as it stands: paths with spaces, quotes in ENVS= and PARAMS=.
# Byte code is kept also where the surroundings forbid it: every process would compile the libraries, the project and the rewritten
# asserts of the tests anew. Packages are installed without theirs: most of it is never used.
export PYTHONDONTWRITEBYTECODE =
export CAPTURE DATASET PARAMS ENVS DEVICE JOBS CAPTURES MEMORY DEMO
SETTINGS = --dataset="$$DATASET" --params="$$PARAMS" --envs="$$ENVS" --device="$$DEVICE" --jobs="$$JOBS" --memory="$$MEMORY"
OPTIONS = $(if $(CAPTURE),"$$CAPTURE") $(SETTINGS)

.PHONY: all plan inspect report tradeoff batch verify gc $(STAGES) setup demo test test-fast crash-test kill-test hostile lint bench $(BENCHES) stability bench-gpu clean help
.DEFAULT_GOAL := help

all plan inspect report tradeoff $(STAGES): $(READY)
	@exec $(BIN)/polarfield $@ $(OPTIONS)

batch: $(READY)
	@exec $(BIN)/polarfield $@ "$$CAPTURES" $(SETTINGS) $(if $(DRY_RUN),--dry-run)

verify: $(READY)
	@exec $(BIN)/polarfield $@ $(OPTIONS) $(if $(FULL),--full) $(if $(REPAIR),--repair)

gc: $(READY)
	@exec $(BIN)/polarfield $@ $(OPTIONS) $(if $(DRY_RUN),--dry-run) $(if $(YES),--yes)

setup: $(READY)  ## the environment alone

# Of the packages' 20 000 files few are ever imported: byte code is made at the first import, not for all of them here.
$(INSTALLED): pyproject.toml constraints.txt tools/system_libraries.sh
	@bash tools/system_libraries.sh
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --quiet --no-compile --disable-pip-version-check --constraint constraints.txt --editable '.[test]'
	@touch $@

# Each is half a minute of one core: side by side, what training runs costs no time of its own on two.
$(READY): $(INSTALLED)
	@echo "compiling the fits and what training runs"
	@$(BIN)/python -m stages.olat.compile & fits=$$!; OMP_NUM_THREADS=1 $(BIN)/python -m stages.train.compile && wait $$fits
	@touch $@

demo: $(READY)  ## a tiny synthetic capture through every stage
	$(BIN)/python -m synth "$$DEMO/captures"
	$(BIN)/polarfield all "$$DEMO/captures/views" --dataset "$$DEMO/views" --device "$$DEVICE"
	$(BIN)/polarfield all "$$DEMO/captures/stage" --dataset "$$DEMO/stage" --device "$$DEVICE"
	@echo "reports: $$DEMO/views/metrics/current/report.html and $$DEMO/stage/metrics/current/report.html"

# One thread for each test, as many at once as there are cores: their arrays are small, and threads that wait for each other cost
# three times the time. The tests of a file stay together (tests/conftest.py).
TESTS = OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1 $(BIN)/python -m pytest -n logical --dist loadfile

# mypy and the compilation take a minute of one core each.
test: $(INSTALLED)  ## everything; `test-fast` first tells soon what is wrong
	@$(MAKE) --no-print-directory --jobs=2 --output-sync=target lint $(READY)
	$(TESTS)

test-fast: $(READY)  ## the fast ones alone: about a minute
	$(TESTS) -m "not slow"

# Thousands of stops, a fifth of a second of one core each: a run, and another that mends what it leaves unless one before left the same.
crash-test: $(READY)  ## stop small runs before each of their changes to the disk; needs a C compiler
	OMP_NUM_THREADS=1 $(BIN)/python tests/crash/points.py --jobs 2

# A third of a second of one core each, where COLMAP runs three.
kill-test: $(READY)  ## kill small runs at a thousand random moments
	OMP_NUM_THREADS=1 $(BIN)/python tests/crash/kills.py --jobs 2

# Twelve hundred of them, each through two commands or more; what stages leave takes two seconds of one core each.
hostile: $(READY)  ## captures and datasets that reach outside, execute or swallow memory, through the program
	OMP_NUM_THREADS=1 $(BIN)/python tests/hostile/run.py

lint: $(INSTALLED)  ## ruff (rules and format) and mypy
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: $(VENV)/.bench  ## all benchmarks, then their page; CAPTURES=folder of captures with ground truth
	$(BIN)/python -m benchmarks $(if $(CAPTURES),--captures "$$CAPTURES")

# What the benchmarks alone need: plots and the solvers to compare with.
$(VENV)/.bench: $(READY)
	$(BIN)/python -m pip install --quiet --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[bench]'
	@touch $@

stability: $(READY)  ## stiff and extreme cases, every verdict in docs/stability.md
	$(BIN)/python -m benchmarks.stability

bench-gpu: $(VENV)/.bench  ## on a machine with an NVIDIA GPU: tests of the CUDA path, rasteriser and training beside the CPU's
	$(TESTS) tests/rasterize tests/train/test_device.py
	$(BIN)/python -m benchmarks.bench_rasterize --cuda --no-reference --json build/rasterize-gpu.json
	$(BIN)/python -m benchmarks.bench_train --device cuda --quick --out build/bench-gpu $(if $(CAPTURES),--captures "$$CAPTURES")

$(BENCHES): $(VENV)/.bench
	$(BIN)/python -m benchmarks --only $(@:bench-%=%) $(if $(CAPTURES),--captures "$$CAPTURES")

clean:  ## caches and the demo; never a dataset
	rm -rf build .pytest_cache .mypy_cache .ruff_cache
	find pipeline stages tests benchmarks synth -name __pycache__ -type d -prune -exec rm -rf {} +

help:
	@echo "make all CAPTURE=folder [DATASET=folder] [PARAMS='train.iterations=500'] [ENVS='a.hdr b.hdr'] [DEVICE=cpu|cuda] [JOBS=n] [MEMORY=16G]"
	@echo
	@echo "all                       every stage that the capture needs, with exactly the PARAMS and ENVS that are given"
	@echo "inspect                   a page that shows what was understood of a capture, before anything long runs"
	@echo "plan                      what 'all' would run, what is done already, and why"
	@echo "$(STAGES)"
	@echo "                          one stage and what it needs; stages that PARAMS does not name stay as in the last run"
	@echo "tradeoff                  error against seconds on this capture, and PARAMS for twice as fast and for the smallest error"
	@echo "report                    write the report of the results in use and say where it lies; runs no other stage"
	@echo "batch                     every stage of every capture; CAPTURES=folder|list [DATASET=folder of datasets] [JOBS=n] [MEMORY=16G]"
	@echo "verify                    name what is damaged of everything in use; DATASET=folder [FULL=1] [REPAIR=1: drop that]"
	@echo "gc                        remove versions that nothing in use was made from; DATASET=folder [DRY_RUN=1] [YES=1]"
	@grep -hE '^[a-z][a-z -]*:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## */\t/' | expand -t 26
	@echo
	@echo "$(BIN)/polarfield STAGE --help lists a stage's parameters"
