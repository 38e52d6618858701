# The project's own commands. Each one first installs the packages it needs into .venv.

PYTHON ?= python3
PYTEST_ARGS ?=
# LOCK= installs the newest versions instead of those in requirements/.
LOCK ?= requirements
# Seconds between lines about an installation.
PROGRESS ?= 10
RUN := .venv/bin/python
PIP = $(RUN) -m pip install --disable-pip-version-check
# A worker that a test ends is not replaced: it would be given the same test again.
PYTEST := -m pytest -p xdist -n auto --dist worksteal --max-worker-restart 0

.DEFAULT_GOAL := help
.PHONY: help demo test test-all docs oldest newest lint sanitize bags fuzz lock clean

help:  ## list these targets
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/make \1\t\2/p' $(MAKEFILE_LIST)

ifneq ($(filter-out help clean,$(MAKECMDGOALS)),)
# The Python beneath an active environment, which may be the very .venv that is to be made.
FOUND := $(shell $(PYTHON) -c 'import os, sys, sysconfig; v = "%d.%d" % sys.version_info[:2]; \
  print(v, sysconfig.get_platform(), sys.executable if sys.prefix == sys.base_prefix else \
  os.path.join(sys.base_prefix, "bin", "python" + v))' 2>/dev/null)
VERSION := $(firstword $(FOUND))
PLATFORM := $(word 2,$(FOUND))
BASE := $(wordlist 3,99,$(FOUND))
ifeq ($(filter 3.10 3.11 3.12 3.13 3.14,$(VERSION)),)
$(error $(PYTHON) is $(or $(VERSION),no Python that runs); kinpole needs Python 3.10 to 3.14: \
  name one, as in make $(firstword $(MAKECMDGOALS)) PYTHON=python3.12)
endif
ifneq ($(AMENT_PREFIX_PATH),)
KIND := $(shell "$(BASE)" -c 'import rclpy' 2>/dev/null && echo ros)
endif
demo_EXTRAS := plot
oldest_EXTRAS := batch,cluster,film,formats,pandas,parquet,plot,test
newest_EXTRAS := $(oldest_EXTRAS)
test_EXTRAS := $(oldest_EXTRAS)
docs_EXTRAS := docs,plot
ifeq ($(KIND),ros)
# numpy and the other packages of that ROS are used, so there is no lock. Its messages are compiled for
# its numpy, and the newest OpenCV would bring another one.
SITE := --system-site-packages
LOCK :=
PINNED := $(shell "$(BASE)" -c 'import numpy; print("numpy==" + numpy.__version__)' 2>/dev/null)
else
ifneq ($(PLATFORM),linux-x86_64)
$(error the package index has wheels of rclpy for linux-x86_64 only, and this Python is \
  $(PLATFORM): source ROS 2 Jazzy, or build the Dockerfile, or install the commands that need no \
  ROS with: $(PYTHON) -m pip install '.[plot]')
endif
KIND := wheels
ROS := ,ros
# Another Python's ROS must not leak in, and the wheels bring one middleware only.
unexport RMW_IMPLEMENTATION $(if $(AMENT_PREFIX_PATH),AMENT_PREFIX_PATH PYTHONPATH LD_LIBRARY_PATH)
endif
COMPILER := $(shell for c in $(CC) gcc clang; do command -v $$c && break; done 2>/dev/null)
# A lock file lists every package, so pip resolves nothing, and later releases change nothing.
LOCKED = $(LOCK)/$*.txt $(if $(COMPILER),,--requirement $(LOCK)/compiler.txt)
INSTALL = $(if $(LOCK),$(PIP) --require-hashes --no-deps --requirement $(LOCKED) && \
  $(PIP) --no-deps --no-build-isolation --editable .,$(PIP) --editable '.[$($*_EXTRAS)$(ROS)]' $(PINNED))
READY := $(VERSION)-$(KIND)
endif

demo: .venv/demo-$(READY)  ## track a four-bar live over DDS; a table, and a picture under out/
	@$(RUN) -m kinpole_ros.tools.cli demo --output out

test: lint  ## lint, types and one test of each kind; PYTEST_ARGS='-k wheel' for some of them
test-all: lint  ## the same with all tests, also those of test/thorough.csv
test test-all:
	@PYTEST_DISABLE_PLUGIN_AUTOLOAD=1 OPENBLAS_NUM_THREADS=1 \
	  $(RUN) $(PYTEST) $(if $(filter test-all,$@),--thorough) $(PYTEST_ARGS)

oldest:  ## all tests with the oldest versions that setup.py allows, in .venv-oldest
newest:  ## all tests with the newest versions there are, in .venv-newest
oldest newest:
	@"$(BASE)" -m venv --clear $(SITE) .venv-$@
	@$(if $(filter oldest,$@),grep -oE "'[A-Za-z][A-Za-z0-9_-]*>=[0-9.]+'" setup.py,:) \
	  | tr -d "'" | sed 's/>=/==/' > .venv-$@/bounds.txt
	@.venv-$@/bin/python -m pip install --quiet --constraint .venv-$@/bounds.txt \
	  --editable '.[$($@_EXTRAS),docs$(ROS)]'
	@PYTEST_DISABLE_PLUGIN_AUTOLOAD=1 OPENBLAS_NUM_THREADS=1 \
	  .venv-$@/bin/python $(PYTEST) --thorough $(PYTEST_ARGS)

docs: .venv/docs-$(READY)  ## the site of the docs, in out/docs; warnings are errors
	@OPENBLAS_NUM_THREADS=1 $(RUN) -m sphinx -q -W --keep-going -E docs out/docs
	@echo 'out/docs/index.html'

lint: .venv/test-$(READY)  ## style and types
	@$(RUN) -m ruff check
	@$(RUN) -m ruff format --check
	@$(RUN) -m mypy

# Tests of compiled code: messages, hostile frames, derivatives.
SANITIZED := core/test_bindings core/test_compiled core/test_hostile_frames tracking/test_pose_input tracking/test_quantities test_marker_messages \
  test_marker_reader test_serialization test_state test_wrong_frames
SANITIZERS := undefined,float-cast-overflow
sanitize: .venv/test-$(READY)  ## tests of the compiled library under the sanitizers of gcc, for addresses and undefined behavior
	@CC=gcc CFLAGS='-O1 -g -fsanitize=address,$(SANITIZERS) -fno-sanitize-recover=$(SANITIZERS) -fno-omit-frame-pointer' \
	  $(RUN) setup.py -q build_ext --inplace --force
	@LD_PRELOAD="$$(gcc -print-file-name=libasan.so) $$(gcc -print-file-name=libubsan.so)" \
	  ASAN_OPTIONS=detect_leaks=0 PYTHONMALLOC=malloc PYTEST_DISABLE_PLUGIN_AUTOLOAD=1 OPENBLAS_NUM_THREADS=1 \
	  $(RUN) $(PYTEST) $(SANITIZED:%=test/%.py) $(PYTEST_ARGS); \
	  status=$$?; $(RUN) setup.py -q build_ext --inplace --force && exit $$status

bags: .venv/demo-$(READY)  ## simulate the bags in bags/ again
	@for scene in four_bar rolling_wheel cardan; do \
	  $(RUN) -m kinpole_ros.tools.cli simulate $$scene --noise 0.0002 --rate 100 --duration 4 \
	    --output bags/$$scene.mcap || exit 1; \
	done

fuzz: .venv/test-$(READY)  ## read 10,000 corrupted bags, corrupted captures, and 100,000 corrupted messages; kill each command 20 times; spoil rigs; other examples of each property
	@$(RUN) test/fuzz_bags.py
	@PYTHONPATH=test/bags $(RUN) test/fuzz_captures.py
	@$(RUN) test/fuzz_messages.py
	@OPENBLAS_NUM_THREADS=1 $(RUN) test/fuzz_kills.py
	@PYTHONPATH=. OPENBLAS_NUM_THREADS=1 $(RUN) test/fuzz_rigs.py
	@HYPOTHESIS_PROFILE=fuzz PYTEST_DISABLE_PLUGIN_AUTOLOAD=1 OPENBLAS_NUM_THREADS=1 \
	  $(RUN) $(PYTEST) $$(grep -rl --include='test_*.py' '^@given' test)

# One resolution for all commands, so that they can share .venv; for Python 3.10 to 3.14.
UV := .venv/bin/uv pip compile setup.py - --universal --python-version 3.10 --generate-hashes \
  --no-strip-extras --no-header --no-annotate --quiet
lock: .venv/test-$(READY)  ## choose the newest versions for requirements/, with their hashes
	@mkdir -p out
	@echo 'setuptools>=64' | $(UV) --upgrade --output-file out/lock.txt $(addprefix --extra , \
	  batch cluster docs film formats pandas parquet plot ros test)
	@for target in 'demo plot' 'test batch cluster film formats pandas parquet plot test' 'docs docs plot'; do \
	  set -- $$target; file=$$1; shift; echo 'setuptools>=64' | $(UV) --constraint out/lock.txt \
	    --output-file requirements/$$file.txt --extra ros $$(printf -- '--extra %s ' "$$@") \
	    || exit 1; \
	done
	@echo ziglang | $(subst setup.py -,-,$(UV)) --upgrade --output-file requirements/compiler.txt

clean:  ## remove .venv and all else that can be made again
	rm -rf .venv .venv-oldest .venv-newest build *.egg-info
	rm -rf .hypothesis .mypy_cache .pytest_cache .ruff_cache out/docs
	rm -f out/demo.mcap out/demo.png kinpole_ros/*.so
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# Made anew for another Python, and when ROS 2 has come or gone.
.venv/%-$(READY): setup.py $(if $(LOCK),$(LOCK)/%.txt) $(wildcard kinpole_ros/core/*/*.[ch])
	@"$(BASE)" -c 'import ensurepip, venv' 2>/dev/null || { echo '$(BASE) has no venv: install it' \
	  '(Debian and Ubuntu: sudo apt install python3-venv), then make again' >&2; exit 1; }
	@echo 'Setting up .venv: a minute or two ...'
	@{ grep -qs 'system-site-packages = $(if $(SITE),true,false)' .venv/pyvenv.cfg && $(RUN) -c \
	  'import pip, sys; sys.exit("%d.%d" % sys.version_info[:2] != "$(VERSION)")' 2>/dev/null; } \
	  || "$(BASE)" -m venv --clear $(SITE) .venv
	@(while sleep $(PROGRESS) >&- 2>&- && kill -0 $$$$ 2>&-; do tail -n 1 .venv/install.log | cut -c 1-99; \
	  done) & progress=$$!; trap "kill $$progress" EXIT; \
	  { $(INSTALL); } > .venv/install.log 2>&1 || { tail -n 25 .venv/install.log >&2; \
	  echo 'The installation failed: the reason is above, all of it in .venv/install.log.' >&2; exit 1; }
	@touch $@
