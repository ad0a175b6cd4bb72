// The hand of the page in node, tick by tick: hand.mjs WASM STEPS.json ROWS.json, at a clock of its own. A row has what
// web/src/hand.ts reads after one tick: force, proxy and device, three numbers each, contact, ticks, media time, code.
import { readFileSync, writeFileSync } from "node:fs";

const [, , wasm, given, out] = process.argv;
const { exports: c } = new WebAssembly.Instance(new WebAssembly.Module(readFileSync(wasm)), { page: Math });
let now = 5000.5;
const rows = [];
const actions = {
  open: ({ file }) => {
    const data = readFileSync(file);
    c.hand_close();
    new Uint8Array(c.memory.buffer).set(data, c.room(data.length));
    if (c.hand_open()) throw new Error("the hand does not open the file");
  },
  move: ({ point, from }) => c.hand_move(...point, Number(!!from), ...(from ?? point)),
  follow: ({ time, speed }) => c.hand_follow(time, speed),
  tick: ({ count }) => {
    for (let n = 0; n < count; n++, now++) {
      while (c.hand_decode());
      c.hand_run(now);
      rows.push([...new Float64Array(c.memory.buffer, c.hand_report(), 13)]);
    }
  },
  late: ({ ms }) => { now += ms; },
};
for (const step of JSON.parse(readFileSync(given, "utf8"))) actions[step.do](step);
writeFileSync(out, JSON.stringify(rows));
