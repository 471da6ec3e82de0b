# Understudy. `make help` lists the targets.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
PIP     = $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt
export OMP_NUM_THREADS ?= 1

SCENARIO   ?= cg_shift
# The cast that flies; empty: the scenario's own.
POPULATION ?=
CONFIG     ?= serl50
# Of the run and of the population: the configuration's, also where that is a path to a .toml.
NAME        = $(basename $(notdir $(CONFIG)))
RUN        ?= runs/$(NAME)
CAST        = $(if $(POPULATION),--population $(POPULATION))

.DEFAULT_GOAL := help
.PHONY: help setup setup-dev fly scenarios campaign test lint train export cast study sweep verification aircraft chapter8 peers \
        decision robustness results bench bench-train clean

help: ## Show this help
	@awk 'BEGIN {FS = ":.*## "} /^[a-z0-9-]+:.*## / {printf "  \033[1m%-12s\033[0m %s\n", $$1, $$2}' $(MAKEFILE_LIST)
	@echo "Variables: SCENARIO=$(SCENARIO) POPULATION=NAME CONFIG=$(CONFIG) RUN=$(RUN) QUICK=1 ARGS='more options'"

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/.sim: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) -e '.[sim]'
	@touch $@

$(VENV)/.dev: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) -e '.[dev]'
	@touch $@ $(VENV)/.sim

setup: $(VENV)/.sim ## Install what flies and the simulator (no torch)

setup-dev: $(VENV)/.dev ## Install everything: training, export, tests

fly: setup ## Fly SCENARIO in its modes over MAVLink; table and HTML report (ARGS=--realtime: wall clock)
	$(BIN)/understudy fly $(SCENARIO) $(CAST) $(ARGS)

scenarios: setup ## Fly every shipped scenario in its own modes, into results/ and docs/img/
	$(BIN)/python -m scenarios.shipped --figures docs/img $(ARGS)

campaign: setup-dev ## Faults x references x ways of adapting (QUICK=1: a few); resumes; into results/
	$(BIN)/python -m scenarios.campaign $(if $(QUICK),--quick,--results results --figures docs/img) $(CAST) $(ARGS)

test: setup-dev ## Run the tests, the linter, the type checker and the import contracts
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m pytest $(ARGS)

lint: setup-dev ## Format and fix what can be fixed by itself
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

train: setup-dev ## Train a population: CONFIG=serl50 | serl10 | td3 | a .toml; resumes where it stopped
	$(BIN)/understudy train $(CONFIG) --out $(RUN) $(ARGS)

export: setup-dev ## Export RUN to populations/NAME; serl50 is shipped with ARGS=--only-fit
	$(BIN)/understudy export $(RUN) populations/$(NAME) $(ARGS)

cast: setup-dev ## Breed the default cast, export it, measure it beside specialists and laws
	$(BIN)/python -m export.cast breed --out runs/citation $(ARGS)
	$(BIN)/understudy export runs/citation populations/citation
	$(BIN)/python -m bench.cast

study: setup-dev ## The thesis's tables and figures of RUN beside TD3 alone (runs/td3), into results/ and docs/img/
	$(BIN)/python -m export.study table71 $(RUN) --td3 runs/td3 $(ARGS)
	$(BIN)/python -m export.study curves $(RUN) runs/td3
	$(BIN)/python -m export.study smoothness $(RUN) runs/td3
	$(BIN)/python -m export.study mutation

verification: setup-dev ## The trainer on other environments, PIDs and aircraft as the thesis verifies them; resumes
	$(BIN)/understudy train pitch_td3
	$(BIN)/understudy train pendulum_ddpg
	$(BIN)/understudy train pendulum_pderl
	$(BIN)/python -m bench.verification
	$(BIN)/understudy train lunar_pderl
	$(BIN)/understudy train lunar_ddpg
	$(BIN)/python -m export.verification.archive --iterations 100
	$(BIN)/python -m export.verification.measure

sweep: setup-dev ## Search the thesis's ranges of hyperparameters; resumes
	$(BIN)/python -m export.study sweep $(ARGS)

aircraft: setup-dev ## Validate the Citation against recordings; prints the table
	$(BIN)/understudy aircraft validate $(ARGS)

chapter8: setup-dev ## The thesis's sudden CG shift: modes x references, into results/
	$(BIN)/python -m scenarios.chapter8 $(CAST) $(ARGS)

results: setup ## Render docs/results.md from results/*.json
	$(BIN)/understudy results

peers: setup-dev ## The classical laws on faults, noise and latency, into results/
	$(BIN)/python -m bench.laws $(ARGS)

decision: setup-dev ## Late commands: state foretold, delay imagined or not looked for, into results/
	$(BIN)/python -m bench.decision $(ARGS)

robustness: setup-dev ## Noisy gyros, lost states, garbage: the presets beside a PID and an INDI, into results/
	$(BIN)/python -m bench.robustness $(ARGS)

bench: setup-dev ## Cost of cycle, link and imagination beside their peers, as ratios; the models' errors
	$(BIN)/python -m bench.cycle
	$(BIN)/python -m bench.link
	$(BIN)/python -m bench.imagination
	$(BIN)/python -m bench.rate_model
	$(BIN)/python -m bench.scheduling

bench-train: setup-dev ## Training speed beside a straightforward implementation
	$(BIN)/python -m bench.train

clean: ## Remove what flights and training left behind
	rm -rf flights runs .pytest_cache .mypy_cache .ruff_cache .import_linter_cache
