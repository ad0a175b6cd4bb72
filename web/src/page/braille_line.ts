// Shows a line of the field through the probe, from the left to the right, on a Braille display; with its button.
import { BrailleDisplay } from "../braille";
import { byId, setPressed } from "../elements";
import { message } from "../saving";
import { say } from "../speech";
import { fingerOf, medium } from "./medium";
import * as probe from "./probe";
import { sizeOf } from "./reading";
import { latest } from "./status";
import { decoder } from "./threads";

const display = new BrailleDisplay(reportConnection);

export function wire(): void {
  byId("braille").hidden = !BrailleDisplay.isSupported;
  byId("braille").onclick = (): void => void (display.isOpen ? display.close() : display.connect());
}

/** Show the line again: the field at the probe has changed. */
export function show(): void {
  if (display.isOpen) showLine();
}

/** Bars from the bottom of the display to its top: on a surface its heights, else forces. */
const showLine = latest(async () => {
  const { isPins, directions, top } = medium!;
  const { columns } = display;
  const { point, walked, extremes } = probe.reading();
  const points = medium!.lineThrough(point, Array.from({ length: columns }, (_, n) => (n + 0.5) / columns)).flat();
  if (walked && extremes) {
    const { lowest, highest } = isPins ? { lowest: 0, highest: 1 } : extremes;
    const heights = await decoder.request<Float64Array>({ do: "profile", directions: fingerOf(directions), points });
    return display.show(Array.from(heights, (height) => (Number.isNaN(height) ? 0 : (height - lowest) / (highest - lowest || 1))));
  }
  const forces = await decoder.request<Float64Array>({ do: "feel", points });
  return display.show(Array.from({ length: columns }, (_, n) => sizeOf(forces.subarray(5 * n)) / top));
});

function reportConnection(report: string): void {
  setPressed("braille", display.isOpen);
  message(report);
  if (!medium) return say(report); // the status line is not shown yet
  if (display.isOpen) probe.feel(probe.point);
}
