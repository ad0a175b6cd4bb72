// The queries of c/touch_query.h in WebAssembly: queries.mjs WASM IN OUT; IN and OUT are those of queries.c.
import { readFileSync, writeFileSync } from "node:fs";

const [, , wasm, given, out] = process.argv;
const { exports: c } = new WebAssembly.Instance(new WebAssembly.Module(readFileSync(wasm)), { page: Math });
const data = readFileSync(given);
const view = new DataView(data.buffer, data.byteOffset, data.length);
const rows = [];
for (let at = 0; at < data.length;) {
  const [bytes, before, after, count] = [0, 8, 16, 24].map((n) => Number(view.getBigInt64(at + n, true)));
  const memory = c.room(bytes); // before the buffer, which it replaces
  new Uint8Array(c.memory.buffer).set(data.subarray(at + 32, at + 32 + bytes), memory);
  at += 32 + bytes;
  for (let n = 0; n < count; n++, at += 32) {
    const query = [0, 8, 16, 24].map((k) => view.getFloat64(at + k, true));
    rows.push(...new Float64Array(c.memory.buffer, c.query(before, after, ...query), 14));
  }
}
writeFileSync(out, new Uint8Array(Float64Array.from(rows).buffer));
