#!/bin/sh
# c/touch.h and c/touch_write.h as WebAssembly: PYTHON build_wasm.sh OUT.wasm, with ziglang in that Python.
set -eu
cd "$(dirname "$0")"
"${PYTHON:-python3}" -m ziglang cc -target wasm32-freestanding -mcpu=generic+bulk_memory+nontrapping_fptoint -O2 -mllvm -inline-threshold=25 -mllvm -unroll-threshold=80 -std=c11 \
  -Wall -Wextra -Wno-unused-function -fno-builtin -nostdlib -fno-sanitize=all \
  -Ifreestanding -Wl,--no-entry -Wl,--max-memory=1073741824 -Wl,-z,stack-size=1048576 -Wl,--strip-all \
  -o "$1" touch_wasm.c freestanding/library.c
