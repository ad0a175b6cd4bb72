// Values of web/freestanding/math.h, by the functions that the page gives and library.c: math_values.mjs WASM INPUT OUTPUT.
import { readFileSync, writeFileSync } from "node:fs";

const [, , wasm, input, output] = process.argv;
const { exports } = new WebAssembly.Instance(new WebAssembly.Module(readFileSync(wasm)), { page: Math }); // as PAGE_MATH
const numbers = new Float64Array(new Uint8Array(readFileSync(input)).buffer);
const out = [];
for (const x of numbers) for (let n = 0; n < 16; n++) out.push(exports.value(n, x));
writeFileSync(output, Buffer.from(Float64Array.from(out).buffer));
