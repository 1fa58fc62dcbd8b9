# hapticd. `make help` lists the targets; each of them first sets up .venv as needed.
#
# Everything is built into .venv/, build/ and hapticd/_core.abi3.so. The C tests are built once for each VARIANT (a compiler
# and its flags) into build/c/VARIANT.

PYTHON ?= python3
CC ?= cc
CLANG ?= clang-22
C_RUNS ?= 1
FUZZ_SECONDS ?= 60
DAEMON_SECONDS ?= 30
DESCRIPTORS ?= 20000
MESSAGES ?= 20000
CONVERSATIONS ?= 200000
DOCUMENTS ?= 20000
RECORDINGS ?= 2000
RELOADS ?= 500
CHANGES ?= 50000
TICKS ?= 10000000

VENV := .venv
# Exact versions of all packages, for pip and for the environment in which pip builds hapticd.
CONSTRAINTS := constraints.txt
BIN := $(VENV)/bin
BUILT := $(VENV)/.built
TOOLS := $(VENV)/.tools
SETUP := pyproject.toml setup.py hapticd/_version.py $(CONSTRAINTS)
C_SOURCES := $(wildcard csrc/*/*.c)
C_FILES := $(wildcard csrc/*/*.[ch] tests/c/*.[ch] tests/model/*.[ch] tests/sanitized/*.[ch] tests/vm/*.[ch])
JOBS := $(shell nproc 2>/dev/null || echo 1)

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.SUFFIXES:
.SECONDARY:

.PHONY: help
help: ## list the targets
	@sed -n 's/^\([a-z][a-z-]*\):.*## \(.*\)/  make \1|\2/p' $(MAKEFILE_LIST) | \
		while IFS='|' read -r target text; do printf '%-16s %s\n' "$$target" "$$text"; done

# ---- Set-up ------------------------------------------------------------------------------------------------------

.PHONY: build
build: $(BUILT) ## set up .venv with the dependencies of all commands, and compile the C core

.PHONY: tools
tools: $(TOOLS) ## add the tools of tests, checks, documentation and packages to .venv

# `make PYTHON=...` sets up .venv again if it has another version of Python.
ifeq ($(origin PYTHON),command line)
ifneq ($(shell $(PYTHON) -V 2>&1),$(shell $(BIN)/python -V 2>&1))
OTHER_PYTHON := other-python
.PHONY: other-python
endif
endif

# A change of the packaging installs again; a change of the C core alone only recompiles.
$(BUILT): $(SETUP) $(OTHER_PYTHON) hapticd/_build.py hapticd/_stub.py $(wildcard csrc/*/*.[ch])
	@if [ ! -x $(BIN)/hapticd ] || [ -n "$(filter $(SETUP) $(OTHER_PYTHON),$?)" ]; then \
		$(MAKE) --no-print-directory install; \
	else \
		echo "compiling the C core"; \
		mkdir -p build && $(BIN)/python setup.py -q build_ext --inplace >build/build.log 2>&1 || \
			{ cat build/build.log >&2; exit 1; }; \
	fi
	@$(BIN)/python -m compileall -q hapticd # without this the first start takes half a second longer
	@touch $@
	@echo "set up: $$($(BIN)/hapticd --version) in $(VENV); next: . $(VENV)/bin/activate, then hapticd run"

pip_install = PIP_CONSTRAINT=$(CONSTRAINTS) PIP_BUILD_CONSTRAINT=$(CONSTRAINTS) \
	$(BIN)/python -m pip install --quiet --disable-pip-version-check

.PHONY: install
install: prerequisites build/build-requires.txt
	@echo "setting up $(VENV) (about a minute, once)"
	@$(PYTHON) -m venv $(if $(OTHER_PYTHON),--clear) $(VENV)
	@$(pip_install) --editable '.[all]' --requirement build/build-requires.txt
	@$(share)

$(TOOLS): $(SETUP) $(OTHER_PYTHON) | $(BUILT)
	@echo "adding the developers' tools to $(VENV) (a minute, once)"
	@$(pip_install) 'hapticd[dev]'
	@touch $@

# The build's own requirements: .venv compiles the C core again whenever it changes.
build/build-requires.txt: pyproject.toml | prerequisites
	@mkdir -p build
	@$(PYTHON) -c 'import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["build-system"]["requires"], sep="\n")' >$@

.PHONY: lock
lock: tools build/build-requires.txt ## write constraints.txt with today's newest versions of all dependencies, for every Python from 3.11 on
	@$(BIN)/pipx run uv pip compile --quiet --universal --python-version 3.11 --all-extras --no-annotate --no-header \
		pyproject.toml build/build-requires.txt >build/constraints.txt
	@{ echo "# Versions of $$(date +%F), written by make lock; what make build installs."; cat build/constraints.txt; } >constraints.txt
	@echo "wrote constraints.txt; try it: make test"

# An editable install lacks the files that a wheel installs below the prefix: copy them.
share = $(BIN)/python setup.py -q build_share && cp -R build/share $(VENV)

# Reports a missing prerequisite in one line.
.PHONY: prerequisites
prerequisites:
	@command -v $(PYTHON) >/dev/null || \
		{ echo "hapticd needs Python 3.11 or newer: no $(PYTHON) found (try make PYTHON=...)" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "hapticd needs Python 3.11 or newer: $$($(PYTHON) --version) found (try make PYTHON=...)" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || \
		{ echo "Python's venv is missing: install python3-venv (Debian, Ubuntu)" >&2; exit 1; }
	@$(PYTHON) -c 'import os, sys, sysconfig as s; \
		sys.exit(not os.path.exists(os.path.join(s.get_path("include"), "Python.h")))' || \
		{ echo "Python's C headers are missing: install python3-dev (Debian, Ubuntu)" >&2; exit 1; }
	@command -v $(CC) >/dev/null || \
		{ echo "no C compiler ($(CC)) found: install gcc (Debian, Ubuntu: build-essential)" >&2; exit 1; }

# ---- For everybody -----------------------------------------------------------------------------------------------

.PHONY: play
play: build ## open the page with the simulated joystick: drag the stylus with the mouse; Ctrl-C ends it
	@$(BIN)/hapticd web --demo --open

.PHONY: demo
demo: build ## run a daemon on the simulated joystick and measure it over ZeroMQ: 75 s, longer if periods are missed
	@$(BIN)/python -m examples.demo

PAPER_STUDIES := tapping texture puncture
PAPER_PEOPLE := $(foreach name,A B C D E F G H,--participant simulated:$(name))

.PHONY: paper-experiments
paper-experiments: build ## run the paper's three experiments with eight simulated participants each, reports in build/paper: a minute
	@rm -rf build/paper && mkdir -p build/paper
	@set -e; for study in $(PAPER_STUDIES); do \
		$(BIN)/hapticd experiment run okamura1998_$$study --offline $(PAPER_PEOPLE) -o build/paper/$$study; \
		$(BIN)/hapticd experiment analyze build/paper/$$study -o build/paper/$$study.html; \
	done

# One pytest process more than processors, because many tests wait for a daemon. Bytecode is kept, whatever the shell's
# settings: compiling it again takes seconds.
PYTEST_ALL = -n $(shell expr $(JOBS) + 1) --dist worksteal
# A test that fails is run a second time, alone.
SECOND_RUN = PYTHONDONTWRITEBYTECODE= $(BIN)/python tests/second_run.py

.PHONY: test
test: tools ## run the C tests and all of pytest that is neither long nor slow: a minute and a half on two processors
	@$(MAKE) --no-print-directory -j$(JOBS) c-build
	@$(SECOND_RUN) $(C_TESTS) -- $(PYTEST_ALL) -m 'not slow and not long'

.PHONY: test-long
test-long: tools ## run the same and the long tests, as CI does: about four minutes
	@$(MAKE) --no-print-directory -j$(JOBS) c-build
	@$(SECOND_RUN) $(C_TESTS) -- $(PYTEST_ALL) -m 'not slow'

.PHONY: test-browser
test-browser: tools ## check that the page opens in Chromium and receives samples
	@HAPTICD_BROWSER=required $(SECOND_RUN) -- -q tests/web/test_page.py::test_the_page_opens_and_samples_come

# A missing browser, compiler or library of a client in another language fails this run; `make test-long` skips its tests.
# Tests marked `alone` take all processors: they run in one process, after the others.
.PHONY: test-slow
test-slow: export HAPTICD_BROWSER = required
test-slow: export HAPTICD_CLIENTS = required
test-slow: tools ## run the slow tests, which make test-long leaves out: an hour
	@failed=0; \
		$(SECOND_RUN) -- -n $(JOBS) --dist worksteal --durations=60 -m 'slow and not alone' || failed=1; \
		$(SECOND_RUN) -- --durations=30 -m alone || failed=1; \
		exit $$failed

.PHONY: test-newest
test-newest: ## run make test-long with the newest version of every dependency, in a separate environment
	@rm -rf build/newest
	@$(MAKE) --no-print-directory test-long VENV=build/newest CONSTRAINTS=

.PHONY: test-pythons
test-pythons: tools ## run make test-long with every Python of this machine from 3.11 on, each in a separate environment
	@failed=0; for python in $$($(BIN)/python packaging/try_wheel.py --list); do \
		echo "$$($$python --version) ($$python)"; \
		$(MAKE) --no-print-directory test-long PYTHON=$$python VENV=build/python-$$(basename $$python) || failed=1; \
	done; exit $$failed

.PHONY: test-vm
test-vm: tools ## test virtual HID joysticks in a virtual machine: needs QEMU, which the first run as root installs
	@PYTHON=$(abspath $(BIN))/python bash tests/vm/test.sh

.PHONY: test-systemd
test-systemd: tools ## test the installed service under systemd and udev in a virtual machine, with QEMU: minutes
	@PYTHON=$(abspath $(BIN))/python bash tests/vm/test.sh -s

.PHONY: deb
deb: tools ## build dist/hapticd_VERSION_ARCH.deb with its dependencies from PyPI; DEB_VERSION=... sets the version: two minutes
	@bash packaging/deb.sh $(BIN)/python $(DEB_VERSION)

.PHONY: test-deb
test-deb: deb ## run lintian on the Debian package; install, upgrade and purge it under systemd in a virtual machine: minutes
	@bash packaging/lint.sh
	@PYTHON=$(abspath $(BIN))/python bash tests/vm/test.sh -d

.PHONY: bench
bench: tools ## measure the errors and times of docs/accuracy.md and docs/benchmarks.md: 15 minutes
	@$(BIN)/python -m bench --overwrite

.PHONY: man
man: build ## write man pages and completion scripts to .venv/share, where man finds them
	@$(share)

.PHONY: vendor-check
vendor-check: tools ## compare the packages that the page includes with npm's
	@$(BIN)/python -m tests.web.vendored

.PHONY: screenshots
screenshots: tools ## take the screenshots in docs/: needs Chromium
	@$(BIN)/python -m docs.screenshots

.PHONY: docs
docs: tools ## build the documentation as a site in build/site, which needs neither a server nor the network
	@$(BIN)/python -m sphinx -q -W --keep-going -d build/doctrees docs build/site
	@echo "open build/site/index.html"

.PHONY: docs-tables
docs-tables: tools ## write the tables of docs/ that come from the code: keys, limits, defaults
	@$(BIN)/python -m docs.tables

.PHONY: format
format: tools ## format C and Python
	@$(BIN)/clang-format -i $(C_FILES)
	@$(BIN)/ruff check --quiet --fix-only .
	@$(BIN)/ruff format --quiet .

.PHONY: clean
clean: ## remove everything that was built, including .venv
	rm -rf $(VENV) build dist *.egg-info hapticd/_core*.so hapticd/_core.c hapticd/_core.pyi
	rm -rf .mypy_cache .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# ---- To install --------------------------------------------------------------------------------------------------

# The sdist, and the wheel built from it. auditwheel tags the wheel with the oldest glibc that it runs with.
.PHONY: wheel
wheel: tools ## build sdist and wheel into dist/; the wheel runs with every Python from 3.11 on and this machine's glibc or newer
	@rm -rf build/wheel dist/hapticd-* && mkdir -p build/wheel
	@{ $(BIN)/python -m build --outdir build/wheel . && \
		PATH="$(abspath $(BIN)):$$PATH" $(BIN)/auditwheel repair --wheel-dir dist build/wheel/hapticd-*.whl && \
		$(BIN)/abi3audit --strict dist/hapticd-*.whl; } >build/wheel.log 2>&1 || { cat build/wheel.log >&2; exit 1; }
	@mv build/wheel/hapticd-*.tar.gz dist/
	@ls -1 dist/*

.PHONY: wheel-test
wheel-test: wheel ## install the wheel as README says, in every Python of this machine and by pipx
	@$(BIN)/python packaging/try_wheel.py dist/hapticd-*.whl

.PHONY: container-test
container-test: tools ## build packaging/Containerfile and run it to a first tap: needs root, buildah, and debootstrap or BASE=image; minutes
	@PYTHON=$(BIN)/python bash packaging/try_container.sh

# ---- Checks of CI and before releases -----------------------------------------------------------------------------

.PHONY: check
check: tools ## run lint, C tests under three sanitizers, make test-long, and the page in Chromium: .ci/run without the fresh user
	@$(MAKE) --no-print-directory -j$(JOBS) --output-sync=target lint tsan asan ubsan
	@$(MAKE) --no-print-directory test-long
	@$(MAKE) --no-print-directory test-browser

VERIFIED = warnings analyze msan rtsan jitter verify-model verify-loops verify-taps rtsan-daemon tsan-daemon verify-units wheel-test test-slow \
	test-vm test-systemd test-deb test-pythons

.PHONY: verify
verify: tools ## run everything that make check leaves out, or the part VERIFIED='...', before you close an issue about its checks: hours
	@mkdir -p build/verify; failed=; for each in $(VERIFIED); do \
		begin=$$(date +%s); \
		if $(MAKE) --no-print-directory $$each >build/verify/$$each.log 2>&1; then said=passed; \
		else said="FAILED, see build/verify/$$each.log"; failed="$$failed $$each"; fi; \
		echo "$$each: $$said, $$(($$(date +%s) - begin)) s"; \
		grep -h '^needed a second run\|^worst case' build/verify/$$each.log; \
	done; [ -z "$$failed" ] || { echo "failed:$$failed" >&2; exit 1; }

.PHONY: lint
lint: tools
	$(BIN)/ruff check .
	$(BIN)/ruff format --check --quiet .
	$(BIN)/mypy --strict hapticd
	$(BIN)/lint-imports --no-logo --no-cache
	@$(BIN)/python -m tests.project.check_includes
	@$(BIN)/python -m tests.project.check_words
	$(BIN)/codespell CHANGELOG.md Makefile README.md bench config csrc docs examples hapticd packaging pyproject.toml systemd
	@echo $(BIN)/clang-format --dry-run -Werror; $(BIN)/clang-format --dry-run -Werror $(C_FILES)

# Builds the extension as users do, then every C file with all warnings. clang also proves that functions marked HD_RT never
# call a function that may block.
.PHONY: warnings
warnings: build
	HAPTICD_WERROR=1 $(BIN)/python setup.py -q build_ext --force --build-lib build/werror --build-temp build/werror
	@$(MAKE) --no-print-directory -j$(JOBS) c-build VARIANT=werror CHECKS=-Werror
	@if command -v $(CLANG) >/dev/null; then \
		$(MAKE) --no-print-directory -j$(JOBS) c-build VARIANT=effects CC=$(CLANG) \
			CHECKS='-Werror -Wfunction-effects -Wno-unknown-warning-option'; \
	else \
		echo "no $(CLANG): -Wfunction-effects was not checked"; \
	fi

.PHONY: verify-units
verify-units: tools ## let systemd check that the units are valid and not more exposed than docs/service.md states
	@if command -v systemd-analyze >/dev/null; then \
		$(BIN)/python -m pytest -q tests/system/test_service_files.py -k 'the_units_are' && \
		for unit in hapticd hapticd-web; do \
			systemd-analyze security --offline=true --no-pager systemd/$$unit.service | tail -n 1; \
		done; \
	else \
		echo "skipped: no systemd-analyze"; \
	fi

.PHONY: analyze
analyze: ## run gcc's static analyser on the C core
	@for source in $(C_SOURCES); do gcc -fanalyzer -Werror $(C_FLAGS) -c $$source -o /dev/null || exit 1; done

.PHONY: verify-model
verify-model: tools ## prove triple buffer and ring with spin, and compare the C code with the models
	@$(BIN)/python -m tests.model.verify

.PHONY: verify-loops
verify-loops: tools ## simulate 10,000 random loops within the margins, 4,000 of overlapping solids: all come to rest
	@$(BIN)/python -m bench.loops --rest --count 6000
	@$(BIN)/python -m bench.loops --rest --count 4000 --first 2000000 --kind overlap

.PHONY: verify-taps
verify-taps: tools ## tap 2,000 times at random, with and without compensation: contacts and displayed errors
	@OPENBLAS_NUM_THREADS=1 $(BIN)/python -m bench.kept_taps

# ---- C tests -----------------------------------------------------------------------------------------------------

VARIANT ?= plain
C_DIR := build/c/$(VARIANT)
C_FLAGS := -std=c11 -O2 -g -ffp-contract=off -fno-math-errno -D_GNU_SOURCE -Icsrc -pthread \
	-Wall -Wextra -Wconversion -Wshadow -Wdouble-promotion -Wstrict-prototypes -Wmissing-prototypes
C_OBJECTS := $(C_SOURCES:csrc/%.c=$(C_DIR)/%.o)
C_TESTS := $(patsubst tests/c/%.c,$(C_DIR)/%,$(wildcard tests/c/test_*.c))

$(C_DIR)/%.o: csrc/%.c Makefile
	@mkdir -p $(@D)
	@$(CC) $(C_FLAGS) $(CHECKS) -MMD -MP -c $< -o $@

$(C_DIR)/test_%: tests/c/test_%.c $(C_OBJECTS) Makefile
	@$(CC) $(C_FLAGS) $(CHECKS) -MMD -MP -MF $@.d $< $(C_OBJECTS) -lm -o $@

-include $(C_OBJECTS:.o=.d) $(C_TESTS:=.d) $(C_DIR)/launcher.d

.PHONY: c-build
c-build: $(C_TESTS)

# Each run after the first has other random cases, a tenth as many: see tests/c/hd_test.h.
.PHONY: c-run
c-run: c-build
	@$(PYTHON) tests/second_run.py --c-runs $(C_RUNS) $(C_TESTS)

.PHONY: ctest
ctest:
	@$(MAKE) --no-print-directory -j$(JOBS) c-run

# ---- Sanitizers --------------------------------------------------------------------------------------------------

# C tests with threads: the others cannot have races.
THREADED = C_TESTS='$(patsubst tests/c/%.c,build/c/$(1)/%,$(shell grep -l pthread.h tests/c/test_*.c))'

# $(call sanitized,VARIANT,SANITIZERS[,WHICH]): the C tests under them, if this clang has their run-time library.
define sanitized
	@command -v $(CLANG) >/dev/null && \
		echo 'int main(void) { return 0; }' | $(CLANG) -fsanitize=$(2) -x c - -o /dev/null 2>/dev/null || \
		{ echo "make $(1) needs $(CLANG) with its sanitizers: install clang-22 and libclang-rt-22-dev" \
			"(Debian), or make $(1) CLANG=..." >&2; exit 1; }
	@echo "C tests with -fsanitize=$(2)"
	@$(MAKE) --no-print-directory -j$(JOBS) c-run VARIANT=$(1) CC=$(CLANG) $(3) \
		CHECKS='-fsanitize=$(2) -fno-sanitize-recover=all -fno-omit-frame-pointer'
endef

.PHONY: tsan asan ubsan msan rtsan
tsan: ## run the C tests with threads under ThreadSanitizer; C_RUNS=1 sets the runs of this and the next five targets
	$(call sanitized,tsan,thread,$(call THREADED,tsan))
asan: ## run the C tests under AddressSanitizer
	$(call sanitized,asan,address)
ubsan: ## run the C tests under UndefinedBehaviorSanitizer
	$(call sanitized,ubsan,undefined$(comma)float-cast-overflow)
msan: ## run the C tests under MemorySanitizer
	$(call sanitized,msan,memory)
rtsan: ## run the C tests under RealtimeSanitizer: the servo never blocks
	$(call sanitized,rtsan,realtime)

.PHONY: jitter
jitter: ## run the C tests with threads, with random delays at each synchronisation
	@$(MAKE) --no-print-directory -j$(JOBS) c-run VARIANT=jitter CHECKS='-include tests/c/hd_jitter.h' $(call THREADED,jitter)

comma := ,

# $(call sanitized_daemon,VARIANT,SANITIZERS): the daemon under them, in a Python that is linked with the core.
define sanitized_daemon
	@command -v $(CLANG) >/dev/null && \
		echo 'int main(void) { return 0; }' | $(CLANG) -fsanitize=$(2) -x c - -o /dev/null 2>/dev/null || \
		{ echo "make $(1)-daemon needs $(CLANG) with its sanitizers: install clang-22, libclang-rt-22-dev and llvm-22" \
			"(Debian), or make $(1)-daemon CLANG=..." >&2; exit 1; }
	@$(MAKE) --no-print-directory -j$(JOBS) c-launcher VARIANT=$(1) CC=$(CLANG) \
		CHECKS='-fsanitize=$(2) -fno-sanitize-recover=all -fno-omit-frame-pointer'
	@$(BIN)/python -m tests.sanitized.daemon $(1) build/c/$(1)/launcher --seconds $(DAEMON_SECONDS)
endef

.PHONY: sanitize-daemon tsan-daemon asan-daemon ubsan-daemon rtsan-daemon
sanitize-daemon: tsan-daemon asan-daemon ubsan-daemon rtsan-daemon ## run the daemon under each of four sanitizers
tsan-daemon: tools ## run the daemon under ThreadSanitizer for DAEMON_SECONDS=30
	$(call sanitized_daemon,tsan,thread)
asan-daemon: tools ## run the daemon under AddressSanitizer
	$(call sanitized_daemon,asan,address)
ubsan-daemon: tools ## run the daemon under UndefinedBehaviorSanitizer
	$(call sanitized_daemon,ubsan,undefined$(comma)float-cast-overflow)
rtsan-daemon: tools ## run the daemon under RealtimeSanitizer
	$(call sanitized_daemon,rtsan,realtime)

# The C code that cffi generates from csrc/api/, and the flags that link an executable with this Python.
build/c/_core.c: $(wildcard csrc/api/hd_api*.h) hapticd/_build.py $(BUILT)
	@mkdir -p $(@D)
	@$(BIN)/python -c 'import runpy; runpy.run_path("hapticd/_build.py")["ffibuilder"].emit_c_code("$@")' >/dev/null

build/c/python.mk: $(BUILT)
	@mkdir -p $(@D)
	@$(BIN)/python -c 'import sysconfig as s; v = s.get_config_vars(); \
		print("PYTHON_CFLAGS := -isystem", s.get_path("include")); \
		print("PYTHON_LIBS := -Wl,--export-dynamic -L{LIBDIR} -L{LIBPL} -Wl,-rpath,{LIBDIR} -lpython{LDVERSION}" \
			" {LIBS} {SYSLIBS}".format(**v))' >$@

ifneq ($(filter c-launcher,$(MAKECMDGOALS)),)
include build/c/python.mk
endif

.PHONY: c-launcher
c-launcher: $(C_DIR)/launcher

$(C_DIR)/_core.o: build/c/_core.c Makefile
	@mkdir -p $(@D)
	@$(CC) $(C_FLAGS) $(CHECKS) -w $(PYTHON_CFLAGS) -c $< -o $@

$(C_DIR)/launcher: tests/sanitized/launcher.c $(C_DIR)/_core.o $(C_OBJECTS) Makefile
	@$(CC) $(C_FLAGS) $(CHECKS) -Werror $(PYTHON_CFLAGS) -MMD -MP -MF $@.d $< $(C_DIR)/_core.o $(C_OBJECTS) \
		$(PYTHON_LIBS) -lm -o $@

.PHONY: fuzz
fuzz: tools ## fuzz the inputs of the C core, FUZZ_SECONDS=60 each, then DESCRIPTORS, MESSAGES, DOCUMENTS=20000 and others
	@echo 'int LLVMFuzzerTestOneInput(const char *d, long s) { return !d && s; }' | \
		$(CLANG) -fsanitize=fuzzer,address,undefined -x c - -o /dev/null 2>/dev/null || \
		{ echo "make fuzz needs $(CLANG) with libFuzzer: install clang-22 and libclang-rt-22-dev (Debian)," \
			"or make fuzz CLANG=..." >&2; exit 1; }
	$(call fuzzed,table,8192)
	$(call fuzzed,report,512)
	$(call fuzzed,replay,4096)
	$(call fuzzed,sim,1024)
	$(BIN)/python -m tests.soak.fuzz_descriptors --runs $(DESCRIPTORS)
	$(BIN)/python -m tests.soak.fuzz_messages --runs $(MESSAGES)
	$(BIN)/python -m tests.soak.fuzz_zmtp --runs $(CONVERSATIONS)
	$(BIN)/python -m tests.soak.fuzz_yaml --runs $(DOCUMENTS)
	@for kind in check operator; do \
		$(BIN)/python -m tests.soak.fuzz_yaml --kind $$kind --runs $$(($(DOCUMENTS) / 50)) || exit 1; \
	done
	$(BIN)/python -m tests.soak.fuzz_yaml --kind reload --runs $(RELOADS)
	$(BIN)/python -m tests.soak.fuzz_recordings --runs $(RECORDINGS)

.PHONY: torture
torture: tools ## check the rule of ramps in every tick under random changes, offline and live: TICKS=10000000, CHANGES=50000
	@$(MAKE) --no-print-directory -j$(JOBS) $(C_DIR)/test_ramp
	$(C_DIR)/test_ramp $(TICKS) $(CHANGES) 1
	$(BIN)/python -m tests.soak.torture_live --ticks $(TICKS) --changes $(CHANGES)

# $(call fuzzed,NAME,LONGEST): tests/c/test_fuzz_NAME.c on inputs of up to LONGEST bytes. Long inputs are tried from the
# first one on, because missing bytes count as zero and a short input covers little.
define fuzzed
	@mkdir -p build/fuzz/$(1)-corpus
	$(CLANG) $(C_FLAGS) -DHD_LIBFUZZER -fsanitize=fuzzer,address,undefined -fno-sanitize-recover=all \
		tests/c/test_fuzz_$(1).c $(C_SOURCES) -lm -o build/fuzz/$(1)
	build/fuzz/$(1) -max_total_time=$(FUZZ_SECONDS) -max_len=$(2) -len_control=0 \
		-artifact_prefix=build/fuzz/$(1)- build/fuzz/$(1)-corpus
endef
