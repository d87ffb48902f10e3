# polarfield: `make all CAPTURE=folder`; `make help` lists the rest.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
DEVICE ?= auto
JOBS ?= 1
DEMO ?= build/demo
STAGES := decode poses masks olat train mesh relight metrics
OPTIONS = $(if $(CAPTURE),"$(CAPTURE)") $(if $(DATASET),--dataset "$(DATASET)") --params "$(PARAMS)" --envs '$(ENVS)' --device $(DEVICE) --jobs $(JOBS)
READY := $(VENV)/.ready

# A misspelt variable would be ignored without a word.
$(foreach wrong,PARAM PARAMETERS ENV ENVIRONMENTS DATASETS,$(if $(filter command,$(origin $(wrong))),\
  $(error $(wrong)= is not a variable of this Makefile: PARAMS=, ENVS=, CAPTURE=, DATASET=, DEVICE=, JOBS= are)))

.PHONY: all plan inspect report gc $(STAGES) setup demo test test-fast lint bench bench-train bench-olat bench-rasterize clean help
.DEFAULT_GOAL := help

all plan inspect report gc $(STAGES): $(READY)
	@$(BIN)/polarfield $@ $(OPTIONS)

setup: $(READY)  ## the environment alone

$(READY): pyproject.toml constraints.txt tools/system_libraries.sh
	@bash tools/system_libraries.sh
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[test]'
	@touch $@

demo: $(READY)  ## a tiny synthetic capture through every stage
	$(BIN)/python -m synth $(DEMO)/captures
	$(BIN)/polarfield all $(DEMO)/captures/views --dataset $(DEMO)/views --device $(DEVICE)
	$(BIN)/polarfield all $(DEMO)/captures/stage --dataset $(DEMO)/stage --device $(DEVICE)
	@echo "reports: $(DEMO)/views/metrics/current/report.html and $(DEMO)/stage/metrics/current/report.html"

test: $(READY) lint  ## everything, fast tests first
	$(BIN)/python -m pytest -m "not slow"
	$(BIN)/python -m pytest -m slow

test-fast: $(READY)  ## under a minute
	$(BIN)/python -m pytest -m "not slow"

lint: $(READY)  ## ruff and mypy
	$(BIN)/ruff check .
	$(BIN)/mypy

bench: bench-rasterize bench-olat bench-train  ## all benchmarks; CAPTURES=folder of captures with ground truth

bench-train bench-olat bench-rasterize: $(READY)
	$(BIN)/python -m benchmarks.$(subst -,_,$@) $(if $(CAPTURES),--captures "$(CAPTURES)")

clean:  ## caches and the demo; never a dataset
	rm -rf build .pytest_cache .mypy_cache .ruff_cache
	find pipeline stages tests benchmarks synth -name __pycache__ -type d -prune -exec rm -rf {} +

help:
	@echo "make all CAPTURE=folder [DATASET=folder] [PARAMS='train.iterations=500'] [ENVS='a.hdr b.hdr'] [DEVICE=cpu|cuda] [JOBS=n]"
	@echo
	@echo "all                       every stage that the capture needs"
	@echo "inspect                   a page that shows what was understood of a capture, before anything long runs"
	@echo "plan                      what would run, and why"
	@echo "report                    bring the metrics up to date and say where the report lies"
	@echo "gc                        remove versions that are not in use; DATASET=folder"
	@echo "$(STAGES)"
	@echo "                          one stage and what it needs"
	@grep -hE '^[a-z][a-z -]*:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## */\t/' | expand -t 26
	@echo
	@echo "$(BIN)/polarfield STAGE --help lists a stage's parameters"
