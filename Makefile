# `make demo` and `make test` do all of their own set-up; `make help` lists the rest.
SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.ONESHELL:
.DEFAULT_GOAL := help
ENV := set +u; source scripts/env.sh; set -u

.PHONY: help setup messages demo test lint bench bench-long accuracy ladder accuracy-compare fuzz soak clean

help:  ## list the targets
	@grep -E '^[a-z-]+: .*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## /\1\t/' | expand -t 18

setup:  ## virtual environment, requirements, colcon build of the package into install/
	@scripts/setup.sh

messages: setup  ## message packages of the event camera drivers, where not installed
	@scripts/build_test_messages.sh

demo: export PARTS = light
demo: setup  ## simulate, replay through the running node, report in out/demo/
	@$(ENV)
	python -m emoflow_ros.commands.demo

lint: setup  ## style and types
	@$(ENV)
	ruff check .
	ruff format --check .
	mypy

test: messages lint  ## lint, types and all tests but the long ones
	@$(ENV)
	python -m pytest --timeout 1200 --numprocesses 3 $(PYTEST_ARGS)  # tests of the node mostly wait; conftest.py bounds the work of one that hangs

bench: messages  ## speed of decoders, estimator, evaluate and node beside their targets, into out/benchmarks/; a quarter of an hour
	@$(ENV)
	python -m benchmarks

bench-long: messages  ## all of benchmarks/ in full, ten minutes of replay and the published loop among them; takes hours
	@$(ENV)
	python -m benchmarks --long

accuracy: setup  ## accuracy and consistency over many recordings, into out/accuracy/; ACCURACY_ARGS=--quick: fewer
	@$(ENV)
	python -m benchmarks.scoreboard $(ACCURACY_ARGS)

ladder: setup  ## the memory of positions rung by rung over 20 recordings, into out/accuracy/ladder.json
	@$(ENV)
	python -m benchmarks.scoreboard.ladder

accuracy-compare: setup  ## two of its results, A=before.json B=after.json
	@$(ENV)
	python -m benchmarks.scoreboard.compare "$(A)" "$(B)"

fuzz: setup  ## decoders on a million inputs each, by hypothesis and by atheris, a thousand damaged files of each format, and as many that the field changes; takes hours
	@$(ENV)
	cache=$$(mktemp -d)
	trap 'rm -rf "$$cache"' EXIT
	NUMBA_BOUNDSCHECK=1 NUMBA_CACHE_DIR="$$cache" python -m pytest --timeout 0 \
		--hypothesis-profile fuzz test/msg_adapters/test_properties.py
	python test/msg_adapters/fuzz_decoders.py
	python test/readers/fuzz_readers.py --runs 1000
	python test/readers/fuzz_variants.py --runs 1000
	python test/readers/fuzz_columns.py --runs 1000

soak: messages  ## the tests that take minutes, and random faults for an hour; SOAK_S=180: for 180 s
	@$(ENV)
	python -m pytest -m soak --timeout 3600 $(PYTEST_ARGS)

clean:  ## remove everything that the other targets made
	rm -rf .venv .test_messages build install log out .mypy_cache .pytest_cache .ruff_cache
