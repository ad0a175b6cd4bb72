// A browser that does what a list of steps says: drive.mjs CHROMIUM STEPS.json ANSWERS.json, run in the folder web.
import { readFileSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { basename, join } from "node:path";
import { climbToTheTop } from "./climb.mjs";

const { chromium } = createRequire(join(process.cwd(), "package.json"))("playwright-core");
const [, , executablePath, given, out] = process.argv;
const { steps, context = {}, flags = [] } = JSON.parse(readFileSync(given, "utf8"));
const args = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist", "--autoplay-policy=no-user-gesture-required", "--js-flags=--expose-gc", "--enable-precise-memory-info", ...flags];
const browser = await chromium.launch({ executablePath, args });
const frame = await browser.newContext({ viewport: { width: 1280, height: 800 }, offline: true, ...context });
const page = await frame.newPage();
const requests = [];
const errors = [];
page.on("request", (request) => requests.push(request.url().slice(0, 200)));
page.on("pageerror", (error) => errors.push(String(error)));
page.on("console", (message) => message.type() === "error" && errors.push(message.text()));

const choosers = []; // a listener from the start: Chromium would otherwise close a dialog before it is reported
page.on("filechooser", (chooser) => choosers.push(chooser));

let screen = null; // one session for all touches: a finger that another session put down is not known

const settled = () => page.waitForFunction(() => /^(ready|fault|empty)$/.test(document.documentElement.dataset.state ?? ""));
const state = () => page.evaluate(() => window.touchfield.state());
const actions = {
  goto: async ({ url }) => { await page.goto(url); await settled(); },
  open: async ({ file }) => {
    await page.evaluate(() => { document.documentElement.dataset.state = "requested"; });
    await page.setInputFiles("#file", file);
    await settled();
  },
  choose: async ({ key, file }) => {
    await page.keyboard.press(key);
    for (let left = 300; !choosers.length && left > 0; left--) await page.waitForTimeout(100);
    await page.evaluate(() => { document.documentElement.dataset.state = "requested"; });
    await choosers.pop().setFiles(file);
    await settled();
  },
  drop: async ({ file }) => {
    const dataTransfer = await page.evaluateHandle(([bytes, name]) => {
      const carried = new DataTransfer();
      carried.items.add(new File([Uint8Array.from(bytes)], name));
      document.documentElement.dataset.state = "requested";
      return carried;
    }, [[...readFileSync(file)], basename(file)]);
    await page.dispatchEvent("body", "drop", { dataTransfer });
    await settled();
  },
  seek: ({ time }) => page.evaluate((t) => window.touchfield.seek(t), time),
  through: () => page.evaluate(async () => {
    const { head, state } = window.touchfield.state();
    if (state !== "ready") return;
    for (let n = 0; n < head.frames && document.documentElement.dataset.state === "ready"; n++) await window.touchfield.seek(n / head.rate);
  }),
  feel: ({ points }) => page.evaluate((p) => window.touchfield.feel(p), points),
  press: async ({ key }) => { await page.keyboard.press(key); await page.waitForTimeout(150); },
  click: ({ id }) => page.click(`#${id}`),
  download: async ({ id, key, path }) => {
    const coming = page.waitForEvent("download", { timeout: 60000 });
    if (key) { await page.focus(`#${id}`); await page.keyboard.press(key); } else await page.click(`#${id}`);
    const download = await coming;
    await download.saveAs(path);
    return download.suggestedFilename();
  },
  attach: ({ id, file }) => page.setInputFiles(`#${id}`, file),
  fill: ({ id, value }) => page.fill(`#${id}`, value),
  move: async ({ x, y }) => { await page.mouse.move(x, y); await page.waitForTimeout(200); },
  drag: async ({ from, to, steps = 8 }) => {
    await page.mouse.move(...from);
    await page.mouse.down();
    await page.mouse.move(...to, { steps });
    await page.mouse.up();
    await page.waitForTimeout(300);
  },
  pen: async ({ type, x, y, force }) => {
    const tablet = await frame.newCDPSession(page);
    await tablet.send("Input.dispatchMouseEvent", { type, x, y, force, button: "left", buttons: type === "mouseReleased" ? 0 : 1, clickCount: 1, pointerType: "pen" });
    await page.waitForTimeout(300);
  },
  touch: async ({ type, points }) => {
    screen ??= await frame.newCDPSession(page);
    await screen.send("Input.dispatchTouchEvent", { type, touchPoints: points.map(([x, y], id) => ({ x, y, id })) });
    await page.waitForTimeout(300);
  },
  place: ({ selector }) => page.locator(selector).boundingBox(),
  wait: ({ ms }) => page.waitForTimeout(ms),
  text: ({ id }) => page.textContent(`#${id}`),
  count: ({ selector }) => page.locator(selector).count(),
  run: ({ code }) => page.evaluate(code),
  within: ({ code }) => page.frames()[1].evaluate(code),
  until: async ({ code, frame = 0 }) => {
    for (let left = 600; !(await page.frames()[frame].evaluate(code)); left--) {
      if (!left) throw new Error(`it is not so after 60 s: ${code}`);
      await page.waitForTimeout(100);
    }
  },
  climb: () => climbToTheTop(page),
  shot: async ({ path }) => { await page.screenshot({ path }); },
  state,
};
const answers = [];
for (const step of steps) answers.push((await actions[step.do](step)) ?? null);
writeFileSync(out, JSON.stringify({ answers, requests, errors }));
await browser.close();
