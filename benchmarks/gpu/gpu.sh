#!/usr/bin/env bash
# Checks and trains with the CUDA backend on a machine that has a GPU but no network.
#
#   benchmarks/gpu/gpu.sh prepare     where there is a package index: fills .carry/ with wheels, gsplat,
#                                 a scene and the commit; take the tree with it to the machine
#   benchmarks/gpu/gpu.sh run         there: installs from .carry/ only, compares CUDA with the CPU
#                                 (`gsynopsis doctor --gpu`), runs the tests marked `gpu`, trains,
#                                 and leaves the results in
#                                 $OUT, or build/gpu/results
#
# Options of prepare: --scene FOLDER (a COLMAP scene), --gsplat FILE (gsplat ready built,
#                     .tgz; without it nvcc builds it there).
# Options of run: --build-gsplat (build it though it came ready built), --steps N,
#                 --cpu (a rehearsal without CUDA: no gsplat, no comparison, and of the tests
#                 those that run anywhere).
# The machine's own: Python 3.12 (PYTHON, python3 if unset) with PyTorch, NumPy, SciPy, Pillow and
# Matplotlib, a C++ compiler, and nvcc if gsplat has to be built.
# Exit code: 0 all is well, 1 a step or a check failed, 2 not run.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."

PYTHON=${PYTHON:-python3}
CARRY=.carry
WORK=build/gpu
CARRIED_MIB=60
GSPLAT=1.5.3
# What a machine made for PyTorch may lack; the versions are those of constraints.txt.
WHEELS="msgspec tyro typeguard docstring_parser typing_extensions rich markdown-it-py mdurl Pygments
  safetensors Jinja2 MarkupSafe scikit_build_core packaging pathspec nanobind cmake ninja
  flip-evaluator pytest iniconfig pluggy hypothesis sortedcontainers"

say() { echo "gpu.sh: $*"; }
stop() { echo "gpu.sh: $2" >&2; exit "$1"; }

prepare() {
  local scene=../shared/data/fox ready="" target size
  while [ $# -gt 0 ]; do
    [ $# -ge 2 ] || stop 2 "$1 needs a value"
    case $1 in
      --scene) scene=$2; [ -d "$scene/sparse/0" ] || stop 2 "$scene: no COLMAP scene there" ;;
      --gsplat) ready=$2; [ -f "$ready" ] || stop 2 "$ready: no such file" ;;
      *) stop 2 "prepare: unknown option $1" ;;
    esac
    shift 2
  done
  rm -rf "$CARRY"
  mkdir -p "$CARRY/wheels" "$CARRY/gsplat"
  download_wheels
  if [ -n "$ready" ]; then cp "$ready" "$CARRY/gsplat/"; fi
  if [ -d "$scene/sparse/0" ]; then
    target=$CARRY/scene/$(basename "$scene")
    mkdir -p "$target/sparse"
    cp -rL "$scene/images" "$target/"
    cp -rL "$scene/sparse/0" "$target/sparse/"
    chmod -R u+w "$target"
  else
    say "no scene at $scene: the run will make a procedural one"
  fi
  git describe --always --dirty --abbrev=40 > "$CARRY/commit"
  size=$(du -sm "$CARRY" | cut -f1)
  [ "$size" -le "$CARRIED_MIB" ] || stop 1 "$CARRY has $size MiB, over $CARRIED_MIB"
  say "$CARRY is ready, $size MiB"
}

download_wheels() {
  local name pin pins=() only=(--no-deps --only-binary=:all: --python-version 3.12
    --implementation cp --platform manylinux_2_28_x86_64 --platform manylinux_2_27_x86_64
    --platform manylinux_2_17_x86_64 --platform manylinux2014_x86_64)
  for name in $WHEELS; do
    pin=$(grep -i "^$name==" constraints.txt) || stop 1 "constraints.txt does not pin $name"
    pins+=("$pin")
  done
  "$PYTHON" -m pip download -q "${only[@]}" -d "$CARRY/wheels" "${pins[@]}"
  "$PYTHON" -m pip download -q "${only[@]}" -d "$CARRY/gsplat" "gsplat==$GSPLAT"
}

first() { if [ -e "$1" ]; then echo "$1"; fi; }

run() {
  local backend=cuda build="" steps="" out=${OUT:-build/gpu/results} code
  while [ $# -gt 0 ]; do
    case $1 in
      --cpu) backend=cpu ;;
      --build-gsplat) build=yes ;;
      --steps) [ $# -ge 2 ] || stop 2 "--steps needs a value"; steps=$2; shift ;;
      *) stop 2 "run: unknown option $1" ;;
    esac
    shift
  done
  need_torch "$backend"
  [ -d "$CARRY/wheels" ] || stop 2 "not run: no $CARRY/wheels; first: benchmarks/gpu/gpu.sh prepare"
  mkdir -p "$out" "$WORK"
  # Not `if road …`: within a condition `set -e` would not stop at the first failure.
  set +e
  (set -e; road "$backend" "$build" "$steps" "$out") 2>&1 | tee "$out/gpu.log"
  code=${PIPESTATUS[0]}
  set -e
  if [ "$code" -ne 0 ]; then stop 1 "failed; what there is lies in $out"; fi
  say "all is well; the results are in $out"
}

need_torch() {
  "$PYTHON" -c 'import torch' 2>/dev/null ||
    stop 2 "not run: $PYTHON has no PyTorch; name another with PYTHON="
  [ "$1" = cpu ] || "$PYTHON" -c 'import sys, torch; sys.exit(not torch.cuda.is_available())' \
    2>/dev/null || stop 2 "not run: no CUDA device that the PyTorch of $PYTHON can use"
}

road() {
  local backend=$1 build=$2 steps=$3 out=$4 failed=0 commit scene options=()
  commit=$(commit_of_tree)
  say "commit $commit"
  scene=$(first "$CARRY"/scene/*)
  make_environment
  if [ "$backend" = cuda ]; then install_gsplat "$build"; fi
  if [ "$backend" = cuda ]; then
    say "checking"
    "$python" -m gsynopsis doctor --gpu --out "$out/check.json" || failed=1
  fi
  say "testing"
  tests "$backend" "$out/tests.xml" || failed=1
  if [ -n "$scene" ]; then options+=(--scene "$scene"); fi
  if [ -n "$steps" ]; then options+=(--steps "$steps"); fi
  say "training"
  "$python" -m benchmarks.gpu.train --backend "$backend" --commit "$commit" --results "$out" \
    --run "$WORK/run" "${options[@]}" || failed=1
  return "$failed"
}

# What libraries of the machine warn of is not for us to fail by.
tests() {
  local marks=gpu
  [ "$1" = cuda ] || marks="not gpu and not slow"
  "$python" -m pytest -q -W default -p no:cacheprovider -m "$marks" --junit-xml "$2" \
    tests/model/test_encoding.py tests/render/test_cuda.py tests/training/test_devices.py \
    tests/training/test_waits.py tests/training/test_device_photos.py tests/evaluation/test_metrics.py \
    tests/training/test_masks.py tests/training/distributed/test_gradient_sync.py tests/evaluation/test_lpips.py
}

commit_of_tree() {
  if [ -e .git ] && git describe --always --dirty --abbrev=40 2>/dev/null; then return; fi
  cat "$CARRY/commit" 2>/dev/null || echo unknown
}

# Sets `python`, an environment that sees the machine's packages, and `site`, where its own are.
make_environment() {
  local theirs
  say "making an environment in $WORK/venv"
  rm -rf "$WORK/venv"
  "$PYTHON" -m venv --without-pip --system-site-packages "$WORK/venv"
  python=$PWD/$WORK/venv/bin/python
  site=$("$python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
  # Where PYTHON is itself an environment, the new one would see its base's packages only.
  theirs=$("$PYTHON" -c 'import os, torch; print(os.path.dirname(os.path.dirname(torch.__file__)))')
  echo "$theirs" > "$site/machine.pth"
  PATH=$PWD/$WORK/venv/bin:$(dirname "$(command -v "$PYTHON")"):$PATH
  export PATH
  requirements > "$WORK/requirements.txt"
  install --find-links "$CARRY/wheels" -r "$WORK/requirements.txt"
  say "building gsynopsis"
  # Never the machine's own copy of it: that stays as it is.
  install --no-build-isolation --no-deps --ignore-installed .
}

install() { "$python" -m pip install -q --no-index --no-cache-dir "$@"; }

# What building, training and reporting need besides PyTorch, as pyproject.toml says it.
requirements() {
  "$python" - <<'END'
import tomllib

with open("pyproject.toml", "rb") as handle:
    table = tomllib.load(handle)
project = table["project"]
extras = project["optional-dependencies"]
names = [*table["build-system"]["requires"], *project["dependencies"]]
names += [*extras["train"], *extras["plots"], "cmake>=3.18", "ninja>=1.10"]
names += [name for name in extras["dev"] if name.startswith(("pytest>", "hypothesis>"))]
print("\n".join(name for name in names if not name.startswith("torch")))
END
}

# The one that came ready built, if it loads on this machine; else from its wheel, with nvcc.
install_gsplat() {
  local ready wheel nvcc capability
  ready=$(first "$CARRY"/gsplat/*.tgz)
  export TORCH_EXTENSIONS_DIR=$PWD/$WORK/extensions
  if [ -z "$1" ] && [ -n "$ready" ]; then
    tar -xzf "$ready" -C "$site"
    if loads "$site/gsplat"; then say "gsplat came ready built"; return; fi
    say "the gsplat that came ready built does not load"
    rm -rf "$site/gsplat"
  fi
  wheel=$(first "$CARRY"/gsplat/*.whl)
  [ -n "$wheel" ] || stop 1 "no gsplat wheel in $CARRY/gsplat"
  nvcc=$(command -v nvcc || first /usr/local/cuda/bin/nvcc)
  [ -n "$nvcc" ] || stop 1 "gsplat has to be built, and there is no nvcc"
  install --no-deps "$wheel"
  capability=$("$python" -c 'import torch; print("%d.%d" % torch.cuda.get_device_capability())')
  say "building gsplat for $capability with $nvcc"
  CUDA_HOME=${CUDA_HOME:-$(dirname "$(dirname "$(readlink -f "$nvcc")")")} MAX_JOBS=$(nproc) \
    TORCH_CUDA_ARCH_LIST=$capability \
    "$python" -c 'from gsplat.cuda._backend import _C; assert _C is not None'
}

# gsplat itself says nothing about a csrc that does not load: it starts to build another.
loads() {
  "$python" - "$1" <<'END'
import importlib.util
import pathlib
import sys

import torch  # noqa: F401

path = next(pathlib.Path(sys.argv[1]).glob("csrc*.so"), None)
if path is None:
    sys.exit("no csrc in it")
try:
    spec = importlib.util.spec_from_file_location("gsplat.csrc", path)
    spec.loader.exec_module(importlib.util.module_from_spec(spec))
except ImportError as error:
    sys.exit(f"csrc: {error}")
END
}

case ${1:-} in
  prepare) shift; prepare "$@" ;;
  run) shift; run "$@" ;;
  *) stop 2 "use: benchmarks/gpu/gpu.sh prepare | run" ;;
esac
