# Two commands on a fresh machine: `make demo` and `make test`; `make docs` builds the site. Everything
# else is for developers.
PYTHON ?= python3
BIN := .venv/bin
JOBS ?= 2
LIBRARIES := libllvm19 libgl1 libx11-6
export MPLBACKEND := Agg

.PHONY: demo test test-all lint docs doctor dist clean

demo: .venv/ready
	$(BIN)/gva-mi demo --out out/demo --overwrite

test: .venv/ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python -m pytest --numprocesses $(JOBS) --dist worksteal

# Nightly: all pages, notebooks, installation, fuzzing and kill -9 too.
test-all: .venv/ready
	$(BIN)/python -m pytest --numprocesses $(JOBS) --dist worksteal -m "slow or not slow"

lint: .venv/ready
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

docs: .venv/docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

doctor: .venv/ready
	$(BIN)/gva-mi doctor

# Wheel and sdist in out/dist, tried in an empty environment. It needs a network, and takes minutes.
dist: | system
	PYTHON=$(PYTHON) tools/dist.sh

.venv/ready: pyproject.toml constraints.txt | system
	@$(PYTHON) -c 'import sys; v = sys.version_info; sys.exit(v < (3, 11) and f"gva_mi needs Python 3.11 or newer, and $(PYTHON) is {v[0]}.{v[1]}: make PYTHON=python3.11 $(MAKECMDGOALS)")'
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt torch
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable ".[dev]"
	@# Type checkers do not follow setuptools' import hook.
	echo "$(CURDIR)" > "$$($(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/gva_mi_types.pth"
	touch $@

.venv/docs: .venv/ready
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable ".[docs]"
	touch $@

# The system's libraries: a libLLVM that Dr.Jit can use, and what pymeshlab's wheel leaves out.
.PHONY: system
system:
	@missing=""; \
	for package in $(LIBRARIES); do \
	  dpkg-query -W -f='$${Status}' $$package 2>/dev/null | grep -q 'install ok installed' || missing="$$missing $$package"; \
	done; \
	if [ -n "$$missing" ] && command -v apt-get >/dev/null; then \
	  if [ "$$(id -u)" = 0 ]; then \
	    apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends $$missing; \
	  else \
	    echo "These system libraries are missing. Install them, then run make again:"; \
	    echo "  sudo apt-get install --no-install-recommends$$missing"; exit 1; \
	  fi; \
	fi

clean:
	rm -rf .venv out build *.egg-info
