// Places that a user comes back to: a mark for comparing two places, and the address of the page, which may name one.
import type { Triple } from "../engine";
import { say } from "../speech";
import * as clock from "./clock";
import { jump } from "./jumps";
import { medium } from "./medium";
import * as probe from "./probe";

let marked: { point: Triple; time: number } | null = null;

export function mark(): void {
  if (!medium) return;
  marked = { point: probe.point, time: clock.time };
  say("This place is marked: b goes back to it.");
}

/** Go to the mark, and mark where the probe was: the same key goes there again. */
export function goBack(): void {
  if (!medium) return;
  if (!marked) return say("No place is marked: n marks one.");
  const { point, time } = marked;
  marked = { point: probe.point, time: clock.time };
  void jump(point, time);
}

/** Put time and place into the address, which then opens the page there. */
export function writeAddress(): void {
  if (!medium) return;
  const place = probe.point.map((m) => (1000 * m).toFixed(2)).join();
  try {
    history.replaceState(null, "", `#t=${clock.time.toFixed(4)}&p=${place}`);
    say("The address of the page now names this time and place.");
  } catch {
    say("The address cannot change within this frame.");
  }
}

/** Go to the time and place that the address names. */
export async function followAddress(): Promise<void> {
  const link = new URLSearchParams(location.hash.slice(1));
  const point = (link.get("p") ?? "").split(",").map((mm) => Number(mm) / 1000);
  const time = Number(link.get("t") ?? 0);
  if (!medium || !link.has("p") || point.length !== 3 || ![...point, time].every(Number.isFinite)) return;
  await jump(point as Triple, Math.min(Math.max(time, 0), medium.seconds));
}
