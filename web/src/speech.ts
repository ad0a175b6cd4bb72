// The sentences that the page speaks (an aria-live region) and writes about heights: what lies under the probe, where the
// surface rises, and what a browser lacks.
import { directionText, type Directions } from "./axes";
import type { Head, Triple } from "./engine";
import type { Extremes, Walked } from "./relief_map";

/** A difference of heights that is none: metres, and of pins a fraction. */
const LEVEL = 1e-6;
const NAMES = ["x", "y", "z"];

/** Say a sentence; one that is the same again differs by a blank, without which a screen reader would stay silent. */
export function say(sentence: string): void {
  const region = document.getElementById("spoken")!;
  region.textContent = region.textContent === sentence ? `${sentence}\u00a0` : sentence;
}

/** The way up from a place, of the eight around it. */
export function slopeText({ around }: Walked, directions: Directions): string {
  let [best, way] = [around[4]! + LEVEL, ""];
  let isLevel = true;
  for (let n = 0; n < 9; n++) {
    const height = around[n]!;
    isLevel &&= Number.isNaN(height) || Math.abs(height - around[4]!) <= LEVEL;
    if (!(height > best)) continue;
    const [i, j] = [(n % 3) - 1, Math.floor(n / 3) - 1];
    best = height;
    way = directionText(directions.right.map((v, k) => i * v + j * directions.ahead[k]!), directions);
  }
  if (way) return `rises ${way}`;
  return isLevel ? "level" : "falls on all sides";
}

/** The height of a place, and how high the highest is. */
export function heightText({ height }: Walked, extremes: Extremes | null, isPins: boolean): string {
  if (Number.isNaN(height)) return "no surface here";
  if (!extremes) return "";
  if (isPins) return `height ${percent(height)} percent, the highest ${percent(extremes.highest)}`;
  return `height ${millimetres(height - extremes.lowest)} millimetres, the highest ${millimetres(extremes.highest - extremes.lowest)}`;
}

const percent = (fraction: number): string => (100 * fraction).toFixed(0);
const millimetres = (metres: number): string => (1000 * metres).toFixed(2);

/** Where a probe is: the column and row of an actuator, from the left and the top, or millimetres from the middle of the box. */
export function placeText(point: Triple, head: Head, directions: Directions): string {
  const { origin, spacing, shape } = head;
  if (head.type === 2) {
    const [i, j] = [0, 1].map((n) => Math.round((point[n]! - origin[n]!) / spacing[n]!)) as [number, number];
    return `column ${i + 1} of ${shape[0]}, row ${directions.up[1] > 0 ? shape[1] - j : j + 1} of ${shape[1]}`;
  }
  const parts = point.map((m, n) => `${NAMES[n]} ${Math.round(1000 * (m - origin[n]! - 0.5 * spacing[n]! * (shape[n]! - 1)))}`);
  return `${parts.join(", ")} millimetres from the middle`;
}

export const WITHOUT_WEBGL = "This browser has no WebGL: a slice through the probe is shown instead of the three-dimensional surface, and the view does not turn. Everything else works: file, figures, keys, speech, sound, rumble and saving.";
export const LOST_WEBGL = "The graphics card has dropped the three-dimensional view; it comes back, or with a reload of the page. Figures, keys, speech and sound go on.";
