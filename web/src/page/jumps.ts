// Jumps of the probe to a point: to the strongest force, and to the voxel with the largest error; with their buttons.
import { byId, element } from "../elements";
import type { Triple } from "../engine";
import * as clock from "./clock";
import * as frames from "./frames";
import type { Medium } from "./medium";
import * as probe from "./probe";
import * as slice from "./slice";
import * as steps from "./steps";

export function start({ head, supplement: { figures } }: Medium): void {
  const jumps: [string, () => void][] = [["Strongest force", () => void jump(frames.strongest)]];
  const worst = figures?.worst_voxel as number[] | undefined;
  if (Array.isArray(worst) && worst.length === 3 && !head.objects) {
    const { origin, spacing, rate } = head;
    const point = worst.map((n, k) => origin[k]! + n * spacing[k]!) as Triple;
    jumps.push(["Largest error", () => void jump(point, Number(figures!.worst_frame ?? 0) / rate)]);
  }
  byId("jumps").replaceChildren(...jumps.map(([textContent, onclick]) => element("button", { type: "button", textContent, onclick })));
}

/** Press a button of the jumps: 0 the strongest force, 1 the largest error, if it is known. */
export function press(n: number): void {
  byId("jumps").querySelectorAll("button")[n]?.click();
}

/** Put probe and slice at a point, at a time of the medium. */
export async function jump(point: Triple, time = clock.time): Promise<void> {
  steps.forget();
  if (time !== clock.time) await frames.showNow(time);
  slice.moveTo(point[slice.axis]!);
  await probe.feelAt(point, false, true);
}
