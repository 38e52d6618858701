# The project's own commands. Each sets up .venv first, when it is missing or what it is made of has
# changed.

PYTHON ?= python3
PYTEST_ARGS ?=
# What .venv is made of, by version and hash; empty takes the newest there are.
CONSTRAINTS ?= constraints.txt
RUN := .venv/bin/python
PIP = $(RUN) -m pip install --disable-pip-version-check
PYTEST := -m pytest -p xdist -n auto --dist loadfile

.DEFAULT_GOAL := help
.PHONY: help demo test docs oldest newest lint bags fuzz constraints clean

help:  ## list these targets
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/make \1\t\2/p' $(MAKEFILE_LIST)

ifneq ($(filter-out help clean constraints,$(MAKECMDGOALS)),)
# The Python beneath an active environment, which may be the very .venv that is to be made.
FOUND := $(shell $(PYTHON) -c 'import os, sys; v = "%d.%d" % sys.version_info[:2]; \
  print(v, sys.executable if sys.prefix == sys.base_prefix else \
  os.path.join(sys.base_prefix, "bin", "python" + v))' 2>/dev/null)
VERSION := $(firstword $(FOUND))
BASE := $(wordlist 2,99,$(FOUND))
ifeq ($(filter 3.10 3.11 3.12 3.13 3.14,$(VERSION)),)
$(error $(PYTHON) is $(or $(VERSION),no Python that runs); kinpole needs Python 3.10 to 3.14: \
  name one, as in make $(firstword $(MAKECMDGOALS)) PYTHON=python3.12)
endif
ifneq ($(AMENT_PREFIX_PATH),)
KIND := $(shell "$(BASE)" -c 'import rclpy' 2>/dev/null && echo ros)
endif
ifeq ($(KIND),ros)
EXTRAS := batch,docs,formats,parquet,plot,test
SITE := --system-site-packages
# What is there of numpy and the like belongs to that ROS.
INSTALL = $(PIP) --editable '.[$(EXTRAS)]'
else
KIND := wheels
EXTRAS := batch,docs,formats,parquet,plot,ros,test
INSTALL = $(if $(CONSTRAINTS),$(PIP) --require-hashes --requirement $(CONSTRAINTS) && \
  $(PIP) --no-deps --no-build-isolation --editable .,$(PIP) --editable '.[$(EXTRAS)]')
# The wheels have one middleware, and no use for parts of a ROS that belongs to another Python.
unexport RMW_IMPLEMENTATION $(if $(AMENT_PREFIX_PATH),AMENT_PREFIX_PATH PYTHONPATH LD_LIBRARY_PATH)
endif
STAMP := .venv/ready-$(VERSION)-$(KIND)
endif

demo: $(STAMP)  ## track a four-bar live over DDS; a table, and a picture under out/
	@$(RUN) -m kinpole_ros.tools.cli demo --output out

test: lint  ## lint, types and all tests; PYTEST_ARGS='-k wheel' for some of them
	@PYTEST_DISABLE_PLUGIN_AUTOLOAD=1 OPENBLAS_NUM_THREADS=1 \
	  $(RUN) $(PYTEST) $(PYTEST_ARGS)

oldest:  ## all tests with the oldest versions that setup.py allows, in .venv-oldest
newest:  ## all tests with the newest versions there are, in .venv-newest
oldest newest:
	@"$(BASE)" -m venv --clear $(SITE) .venv-$@
	@$(if $(filter oldest,$@),grep -oE "'[A-Za-z][A-Za-z0-9_-]*>=[0-9.]+'" setup.py,:) \
	  | tr -d "'" | sed 's/>=/==/' > .venv-$@/bounds.txt
	@.venv-$@/bin/python -m pip install --quiet --constraint .venv-$@/bounds.txt \
	  --editable '.[$(EXTRAS)]'
	@PYTEST_DISABLE_PLUGIN_AUTOLOAD=1 OPENBLAS_NUM_THREADS=1 \
	  .venv-$@/bin/python $(PYTEST) $(PYTEST_ARGS)

docs: $(STAMP)  ## the site of the docs, in out/docs; warnings are errors
	@OPENBLAS_NUM_THREADS=1 $(RUN) -m sphinx -q -W --keep-going -E docs out/docs
	@echo 'out/docs/index.html'

lint: $(STAMP)  ## style and types
	@$(RUN) -m ruff check
	@$(RUN) -m ruff format --check
	@$(RUN) -m mypy

bags: $(STAMP)  ## simulate the bags in bags/ again
	@for scene in four_bar rolling_wheel cardan; do \
	  $(RUN) -m kinpole_ros.tools.cli simulate $$scene --noise 0.0002 --rate 100 --duration 4 \
	    --output bags/$$scene.mcap || exit 1; \
	done

fuzz: $(STAMP)  ## read 10,000 corrupted bags and 100,000 corrupted messages; kill each command 20 times; spoil rigs
	@$(RUN) test/fuzz_bags.py
	@$(RUN) test/fuzz_messages.py
	@OPENBLAS_NUM_THREADS=1 $(RUN) test/fuzz_kills.py
	@PYTHONPATH=. OPENBLAS_NUM_THREADS=1 $(RUN) test/fuzz_rigs.py

# For Python 3.10 to 3.14. The compiler of constraints is uv: pip install uv.
constraints:  ## choose the newest versions for constraints.txt, with their hashes
	@echo 'setuptools>=64' | uv pip compile setup.py - --extra batch --extra docs \
	  --extra formats --extra parquet --extra plot --extra ros --extra test --universal --python-version 3.10 --upgrade --generate-hashes \
	  --no-header --no-annotate --quiet --output-file constraints.txt

clean:  ## remove .venv and all else that can be made again
	rm -rf .venv .venv-oldest .venv-newest build *.egg-info
	rm -rf .hypothesis .mypy_cache .pytest_cache .ruff_cache out/docs
	rm -f out/demo.mcap out/demo.png kinpole_ros/derivatives/*.so
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# Begun anew for another Python, and when ROS 2 has come or gone. The kernel is built along with it
# if there is a compiler, and nothing is said if there is none.
$(STAMP): setup.py $(CONSTRAINTS) $(wildcard kinpole_ros/*/_kernel*.[ch])
	@"$(BASE)" -c 'import ensurepip, venv' 2>/dev/null || { echo '$(BASE) has no venv: install it' \
	  '(Debian and Ubuntu: sudo apt install python3-venv), then make again' >&2; exit 1; }
	@echo 'Setting up .venv: a minute or two ...'
	@{ grep -qs 'system-site-packages = $(if $(SITE),true,false)' .venv/pyvenv.cfg && $(RUN) -c \
	  'import pip, sys; sys.exit("%d.%d" % sys.version_info[:2] != "$(VERSION)")' 2>/dev/null; } \
	  || "$(BASE)" -m venv --clear $(SITE) .venv
	@{ $(INSTALL); } > .venv/install.log 2>&1 || { tail -n 25 .venv/install.log >&2; \
	  echo 'The installation failed, see above; all it said is in .venv/install.log.' \
	  $(if $(SITE),,'Without ROS 2 it needs Linux on x86-64.') >&2; exit 1; }
	@touch $@
