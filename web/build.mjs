// The pages, each in one file: wasm, worker, styles and scripts in it, and the hash of the sources of all.
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
const HEADERS = ["", ...["cells", "effects", "encode", "friction", "log", "media_clock", "model", "play", "proxy", "proxy_jump", "proxy_search", "query", "receiver", "render", "seam", "segment_blend", "settings", "shared", "slopes", "timing", "tool", "vector", "write"].map((name) => `_${name}`)].map((name) => `../c/touch${name}.h`);

/** The pages: the file that is written, its markup, its styles, and the script that runs. */
const PAGES = [
  { name: "page.html", html: "page.html", css: "page.css", entry: "main.ts" },
  { name: "map.html", html: "map.html", css: "map.css", entry: "map.ts" },
];

/** Every file that the pages are made from; tests/viewer/test_page.py hashes the same. */
const SOURCES = [...HEADERS, "build.mjs", "build_wasm.sh", "hand.c", "package-lock.json", ...PAGES.flatMap(({ html, css }) => [html, css]), "page.h", "record.h", "relief.h", "surface.h", "three_core.mjs", "touch_wasm.c", "unused_methods.mjs",
  ...listed("freestanding", ""), ...listed("src", ".ts")];
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

const wasm = join(tmpdir(), `touch-${process.pid}.wasm`);
execFileSync("sh", [join(here, "build_wasm.sh"), wasm], { stdio: "inherit" });
const packed = gzipSync(readFileSync(wasm), { level: 9 });
packed[9] = 255; // of no system in particular
const worker = await bundle("worker.ts");
const shared = {
  SOURCES: sources.digest("hex"), WASM: packed.toString("base64"), WORKER: worker, LICENCE: read("node_modules/three/LICENSE").trim(), SAMPLE: readFileSync(join(here, SAMPLE)).toString("base64"),
};
const kb = (data) => (gzipSync(data, { level: 9 }).length / 1000).toFixed(1);
console.log(`wasm ${kb(readFileSync(wasm))} kB gz, worker ${kb(worker)}`);
mkdirSync(out, { recursive: true });
for (const { name, html, css, entry } of PAGES) {
  const main = await bundle(entry);
  const styles = read(css).replaceAll(/\n\s*/g, "\n").trim();
  const parts = { ...shared, SCRIPT: hashOf(main), STYLE: hashOf(styles), CSS: styles, MAIN: main };
  const page = read(html).replaceAll(/@([A-Z]+)@/g, (whole, key) => parts[key] ?? whole);
  writeFileSync(join(out, name), page);
  console.log(`${name}: main ${kb(main)} kB gz, whole page ${kb(page)} kB gz`);
}
