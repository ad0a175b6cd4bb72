// Finds the highest point of a surface as a person does who cannot see it: by keys, and by what the page speaks.
const STEPS = 50; // coarse steps across the box
const EVERY = 10; // steps between the places that are tried first
const STARTS = 12;
const KEYS = { left: "ArrowLeft", right: "ArrowRight", "away from you": "ArrowUp", "towards you": "ArrowDown" };

const numbers = (text) => (text.match(/-?\d+(\.\d+)?/g) ?? []).map(Number);

/** Listen: press t, and wait for another sentence. */
async function listen(page) {
  const spoken = page.locator("#spoken");
  const before = await spoken.textContent();
  await page.keyboard.press("t");
  await page.waitForFunction((text) => document.getElementById("spoken").textContent !== text, before, { polling: 5 });
  const sentence = await spoken.textContent();
  const [first] = sentence.split(";");
  const [height = -Infinity, highest] = numbers(first);
  return { sentence, height, highest, ways: Object.keys(KEYS).filter((way) => first.includes(`rises`) && first.includes(way)) };
}

/** Press a key, or hold it down until it has repeated so often. */
async function press(page, key, times = 1) {
  if (times === 1) return page.keyboard.press(key);
  await Promise.all(Array.from({ length: times }, () => page.keyboard.down(key)));
  await page.keyboard.up(key);
}

/** Go up as long as the page names a way up. */
async function climb(page, prefix = "") {
  let heard = await listen(page);
  for (let left = 200; heard.ways.length && left > 0; left--) {
    for (const way of heard.ways) await press(page, prefix + KEYS[way]);
    heard = await listen(page);
  }
  return heard;
}

async function toCorner(page) {
  await press(page, "ArrowLeft", STEPS + 2);
  await press(page, "ArrowDown", STEPS + 2);
}

/** Places about the surface, the highest first, as steps from a corner. */
async function survey(page) {
  const heard = [];
  await toCorner(page);
  for (let ahead = 0; ahead <= STEPS; ahead += EVERY) {
    const isBack = (ahead / EVERY) % 2 === 1;
    for (let n = 0; n <= STEPS; n += EVERY) {
      heard.push({ right: isBack ? STEPS - n : n, ahead, ...(await listen(page)) });
      if (n < STEPS) await press(page, isBack ? "ArrowLeft" : "ArrowRight", EVERY);
    }
    await press(page, "ArrowUp", EVERY);
  }
  return heard.sort((a, b) => b.height - a.height).slice(0, STARTS);
}

/** The last sentence that is heard on the highest point. */
export async function climbToTheTop(page) {
  await press(page, "f");
  let best = await listen(page);
  for (const { right, ahead } of await survey(page)) {
    await toCorner(page);
    await press(page, "ArrowRight", right);
    await press(page, "ArrowUp", ahead);
    await climb(page);
    await press(page, "Shift+ArrowLeft");
    const heard = await climb(page, "Shift+");
    if (heard.height > best.height) best = heard;
    if (heard.height >= heard.highest - 0.05) return heard.sentence;
  }
  return best.sentence;
}
