// The ticks of conformance/ticks in WebAssembly: ticks.mjs WASM FILE... prints the largest difference of each file from its
// forces, N, and torques, N m; exit status 1 if one is above 1e-9, or a file is none.
import { readFileSync } from "node:fs";

const TOLERANCE = 1e-9;
const [, , wasm, ...files] = process.argv;
const module = new WebAssembly.Module(readFileSync(wasm));
let hasFailed = files.length === 0;
for (const file of files) {
  const { exports: c } = new WebAssembly.Instance(module, { page: Math });
  const data = readFileSync(file);
  const view = new DataView(data.buffer, data.byteOffset, data.length);
  if (data.toString("latin1", 0, 8) !== "TICKS002") throw new Error(`${file} has no ticks of this version`);
  const [bytes, own, , pieces, ticks, numbers] = [8, 16, 24, 32, 40, 48].map((at) => Number(view.getBigInt64(at, true)));
  if (own !== c.receiver_bytes()) throw new Error(`${file} has a receiver of another size`);
  const memory = c.room(bytes);
  let at = 56;
  for (let n = 0; n < pieces; n++) {
    const [offset, size] = [at, at + 8].map((i) => Number(view.getBigInt64(i, true)));
    if (offset < 0 || offset + size > bytes) throw new Error(`${file} has a piece outside of its memory`);
    new Uint8Array(c.memory.buffer).set(data.subarray(at + 16, at + 16 + size), memory + offset);
    at += 16 + size;
  }
  let largest = 0;
  for (let n = 0; n < ticks; n++, at += 8 * numbers) {
    const row = Array.from({ length: numbers }, (_, k) => view.getFloat64(at + 8 * k, true));
    if (numbers > 11) c.orient(...row.slice(11, 15));
    const expected = numbers > 11 ? [...row.slice(8, 11), ...row.slice(15, 18)] : row.slice(8, 11);
    const got = new Float64Array(c.memory.buffer, c.tick(...row.slice(0, 8)), expected.length);
    for (let k = 0; k < expected.length; k += 3) {
      const distance = Math.hypot(...expected.slice(k, k + 3).map((v, m) => v - got[k + m]));
      largest = Math.max(largest, Number.isNaN(distance) ? Infinity : distance);
    }
  }
  console.log(`${file} ${largest.toPrecision(3)} ${ticks}`);
  if (!(largest <= TOLERANCE)) hasFailed = true;
}
process.exit(hasFailed ? 1 : 0);
