// The pages, each in one file with its styles and scripts, and page.html also with wasm and worker; the hash of all sources lies in each.
import { build } from "esbuild";
import { execFileSync } from "node:child_process";
import { createHash } from "node:crypto";
import { mkdirSync, readFileSync, readdirSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { gzipSync } from "node:zlib";
import { threeCore } from "./three_core.mjs";
import { withoutUnusedMethods } from "./unused_methods.mjs";

const here = dirname(fileURLToPath(import.meta.url));
const out = process.argv[2] ?? join(here, "../src/touchfield/viewer/web");
const read = (name) => readFileSync(join(here, name), "utf8");
const listed = (folder, ending) => readdirSync(join(here, folder)).filter((n) => n.endsWith(ending)).sort().map((n) => `${folder}/${n}`);

const SAMPLE = "../conformance/v1/touch-large.touch";

/** Headers of c/ that touch_wasm.c and hand.c include. */
const HEADERS = ["", ...["cells", "effects", "encode", "friction", "log", "media_clock", "model", "play", "proxy", "proxy_damping", "proxy_jump", "proxy_search", "query", "receiver", "render", "seam", "segment_blend", "settings", "shared", "slopes", "timing", "tool", "vector", "write"].map((name) => `_${name}`)].map((name) => `../c/touch${name}.h`);

/** Every file that the page is made from; tests/viewer/test_page.py hashes the same. */
const SOURCES = [...HEADERS, "build.mjs", "build_wasm.sh", "hand.c", "map.css", "map.html", "package-lock.json", "page.css", "page.h", "page.html", "record.h", "relief.h", "surface.h", "three_core.mjs", "timeline.css", "timeline.html", "touch_wasm.c", "unused_methods.mjs",
  ...listed("freestanding", ""), ...listed("src", ".ts"), ...listed("src/page", ".ts")];
const sources = createHash("sha256");
for (const name of SOURCES) sources.update(name).update("\0").update(read(name)).update("\0");

const OPTIONS = { bundle: true, write: false, target: "es2022", legalComments: "none", charset: "utf8", absWorkingDir: here };

/** A script in one piece; bundled twice, so that what only unused methods need is left out. */
async function bundle(name) {
  const whole = await build({ ...OPTIONS, entryPoints: [join(here, "src", name)], format: "esm", plugins: [threeCore] });
  const contents = withoutUnusedMethods(whole.outputFiles[0].text);
  const done = await build({ ...OPTIONS, stdin: { contents, resolveDir: here }, format: "iife", minify: true });
  return done.outputFiles[0].text.trim().replaceAll("</script", "<\\/script").replaceAll("<!--", "<\\!--");
}

const hashOf = (text) => `'sha256-${createHash("sha256").update(text).digest("base64")}'`;

/** Each page in one file: its name, markup, style sheet and script. */
const PAGES = [
  { name: "page.html", html: "page.html", css: "page.css", entry: "main.ts" },
  { name: "timeline.html", html: "timeline.html", css: "timeline.css", entry: "timeline.ts" },
  { name: "map.html", html: "map.html", css: "map.css", entry: "map.ts" },
];

const wasm = join(tmpdir(), `touch-${process.pid}.wasm`);
execFileSync("sh", [join(here, "build_wasm.sh"), wasm], { stdio: "inherit" });
const packed = gzipSync(readFileSync(wasm), { level: 9 });
packed[9] = 255; // of no system in particular
const shared = {
  SOURCES: sources.digest("hex"), WASM: packed.toString("base64"), WORKER: await bundle("worker.ts"), LICENCE: read("node_modules/three/LICENSE").trim(), SAMPLE: readFileSync(join(here, SAMPLE)).toString("base64"),
};
const kb = (data) => (gzipSync(data, { level: 9 }).length / 1000).toFixed(1);
mkdirSync(out, { recursive: true });
for (const { name, html, css, entry } of PAGES) {
  const [main, style] = [await bundle(entry), read(css).replaceAll(/\n\s*/g, "\n").trim()];
  const parts = { ...shared, SCRIPT: hashOf(main), STYLE: hashOf(style), CSS: style, MAIN: main };
  const page = read(html).replaceAll(/@([A-Z]+)@/g, (whole, key) => parts[key] ?? whole);
  writeFileSync(join(out, name), page);
  console.log(`${name}: script ${kb(main)} kB gz, whole ${kb(page)} kB gz`);
}
console.log(`wasm ${kb(readFileSync(wasm))} kB gz, worker ${kb(shared.WORKER)} kB gz`);
