#!/bin/sh
# The module of the page, WebAssembly: PYTHON build_wasm.sh OUT.wasm, with ziglang in that Python.
set -eu
cd "$(dirname "$0")"
zig() { "${PYTHON:-python3}" -m ziglang cc -target wasm32-freestanding -mcpu=generic+bulk_memory+nontrapping_fptoint -std=c11 \
  -Wall -Wextra -Wno-unused-function -fno-builtin -nostdlib -fno-sanitize=all -Ifreestanding "$@"; }
objects=$(mktemp -d)
trap 'rm -r "$objects"' EXIT
zig -O2 -mllvm -inline-threshold=25 -mllvm -unroll-threshold=80 -c -o "$objects/decoder.o" touch_wasm.c
zig -Oz -c -o "$objects/hand.o" hand.c # small rather than fast
zig -O2 -c -o "$objects/library.o" freestanding/library.c
zig -O2 -Wl,--no-entry -Wl,--max-memory=1073741824 -Wl,-z,stack-size=1048576 ${STRIP--Wl,--strip-all} \
  -o "$1" "$objects/decoder.o" "$objects/hand.o" "$objects/library.o"
