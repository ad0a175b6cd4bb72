// The queries of the page's decoder: queries_page.mjs WASM FILE.touch IN OUT. IN: float64 [n][4], the number of a frame, which
// may have a fraction, and a point, metres. OUT: float64 [n][5], force, amplitude and frequency.
import { readFileSync, writeFileSync } from "node:fs";

const [, , wasm, stream, given, out] = process.argv;
const { exports: c } = new WebAssembly.Instance(new WebAssembly.Module(readFileSync(wasm)), { page: Math });
const [file, data] = [readFileSync(stream), readFileSync(given)];
const room = c.room(file.length); // before the buffer, which it replaces
new Uint8Array(c.memory.buffer).set(file, room);
if (c.open()) throw new Error("the page does not open the file");
const numbers = new Float64Array(data.buffer.slice(data.byteOffset, data.byteOffset + data.length));
const rows = [];
for (let n = 0; n < numbers.length; n += 4) {
  if (c.show(numbers[n])) throw new Error(`the page does not show frame ${numbers[n]}`);
  rows.push(...new Float64Array(c.memory.buffer, c.feel(...numbers.subarray(n + 1, n + 4)), 5));
}
writeFileSync(out, new Uint8Array(Float64Array.from(rows).buffer));
