// Following the surface: where on it the probe is, how high that is, and how high the whole surface is.
import type { Triple } from "../engine";
import type { Extremes, Walked } from "../relief_map";
import * as clock from "./clock";
import { depthOf } from "./depth";
import { along, fingerOf, medium } from "./medium";
import { decoder } from "./threads";

/** A place of the surface with the field there, and the point in front of it from which a hand comes down. */
export interface Place extends Walked {
  field: Float64Array;
  before: Triple;
}

/** Whether the user chose to follow the surface. */
export let isChosen = false;
/** The place of the surface that the probe is on; null: it is on none. */
export let walked: Walked | null = null;
/** The lowest and the highest height of the surface. */
export let extremes: Extremes | null = null;
/** Medium, time and field whose extremes these are. */
let extremesOf: unknown[] = [];
/** Whether the latest step was fine: slopes are then those of a small neighbourhood. */
let isFine = false;

export const choose = (on: boolean): void => void (isChosen = on);
export const setFine = (on: boolean): void => void (isFine = on);
export const leave = (): void => void (walked = null);

/** Whether the probe follows the surface: on pins it always does. */
export const isActive = (): boolean => isChosen || (medium?.isPins ?? false);

/** Whether up is away from the surface: arrow keys then move over it as over a map. */
export function isFromAbove(): boolean {
  const { up, outward } = medium!.directions;
  return along(up)[0] === along(outward)[0];
}

/** Find the surface in front of or behind a point; null if another medium was opened meanwhile. */
export async function find(point: Triple): Promise<Place | null> {
  const current = medium!;
  const at = current.snapped(point);
  const finger = fingerOf(current.directions);
  await measure();
  const depth = depthOf(current);
  const steps = [finger.right, finger.ahead].map((direction) => current.step(along(direction)[0], isFine)) as [number, number];
  const found = await decoder.request<Walked & { field: Float64Array }>({ do: "walk", walk: { ...finger, at, depth, steps } });
  if (current !== medium) return null;
  walked = found;
  const [axis, sign] = along(finger.outward);
  const before = [...found.point] as Triple;
  before[axis] = before[axis]! + 1.5 * sign * depthOf(current);
  return { ...found, before };
}

/** Measure the whole surface, once for all that is shown at a time. */
async function measure(): Promise<void> {
  const shown = [medium, clock.time, medium!.what];
  if (shown.every((value, n) => value === extremesOf[n])) return;
  extremesOf = shown;
  extremes = await decoder.request<Extremes | null>({ do: "extremes", directions: fingerOf(medium!.directions) });
}
