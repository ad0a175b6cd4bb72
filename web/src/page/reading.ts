// What is under the probe, in words: for the panel, and for speech.
import { directionText } from "../axes";
import type { Triple } from "../engine";
import type { Extremes, Walked } from "../relief_map";
import { heightText, placeText, slopeText } from "../speech";
import type { Medium } from "./medium";

export interface Reading {
  point: Triple;
  /** Force in newtons or, in a difference, in error bounds; then vibration: newtons and hertz, or the bound in newtons. */
  force: Float64Array;
  /** The place of the surface that the probe follows, and the surface's lowest and highest heights; null: it follows none. */
  walked: Walked | null;
  extremes: Extremes | null;
}

/** |F|. */
export const sizeOf = (force: Float64Array): number => Math.hypot(force[0]!, force[1]!, force[2]!);

/** Newtons at which the field vibrates; a difference has no vibration. */
export const vibrationOf = (force: Float64Array, { isError }: Medium): number => (isError ? 0 : force[3]!);

/** Height and slope where the probe follows a surface. */
export function surfaceText({ walked, extremes }: Reading, { directions, isPins }: Medium): string {
  return walked ? `${heightText(walked, extremes, isPins)}, ${slopeText(walked, directions)}` : "";
}

/** |F|; of pins the height, in percent. */
export function sizeText({ force }: Reading, { isError, isPins, top }: Medium): string {
  const size = sizeOf(force);
  return isPins && !isError ? ((100 * size) / top).toFixed(0) : size.toFixed(2);
}

/** The components of a force, the size of an error, or which pin it is. */
export function partsText({ point, force }: Reading, { head, directions, isError, isPins }: Medium): string {
  if (isError) return `${(1000 * sizeOf(force) * force[3]!).toFixed(1)} of ${(1000 * force[3]!).toFixed(1)} mN`;
  if (isPins) return placeText(point, head, directions);
  return `x ${force[0]!.toFixed(2)}   y ${force[1]!.toFixed(2)}   z ${force[2]!.toFixed(2)} N`;
}

/** What is spoken: height, force and place. */
export function spokenText(reading: Reading, medium: Medium): string {
  const place = placeText(reading.point, medium.head, medium.directions);
  return [surfaceText(reading, medium), spokenForce(reading.force, medium), place].filter(Boolean).join("; ");
}

/** The force under the probe; of pins, whose heights are spoken, nothing. */
function spokenForce(force: Float64Array, medium: Medium): string {
  const { directions, isError, isPins, top } = medium;
  const size = sizeOf(force);
  if (isPins && !isError) return "";
  if (!(size > 0.002 * top)) return isError ? "no difference" : "no force";
  const vibration = vibrationOf(force, medium) > 0 ? `, vibrates at ${force[4]!.toFixed(0)} hertz` : "";
  return `${size.toFixed(2)} ${isError ? "of the error bound" : "newtons"}, ${directionText(force, directions)}${vibration}`;
}
