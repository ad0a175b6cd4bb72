// The probe: where it is, the field there, and the force on the hand that holds it.
import type { Met, Triple } from "../engine";
import { depthOf } from "./depth";
import * as forcePanel from "./force_panel";
import { medium, type Medium } from "./medium";
import { view } from "./outputs";
import type { Reading } from "./reading";
import * as slice from "./slice";
import { latest, stamp } from "./status";
import * as walk from "./surface_walk";
import { decoder, hand } from "./threads";

const PAUSE_S = 0.25; // a probe that has not moved for so long does not slide
const LIFTED = 0.05; // of the box's diagonal: over a longer way the hand is lifted

export let point: Triple = [0, 0, 0];
/** The field at the probe: force, then vibration in newtons and hertz; in a difference the bound in place of these. */
export let field: Float64Array = new Float64Array(5);
/** What is shown of it: the force on the hand, where there is one. */
export let force: Float64Array = field;
/** Where a hand first met the field. */
export let entry: Triple | null = null;
/** Whether another program moves the probe, and renders the force itself. */
let isFollowing = false;
let latestMove = { at: 0, speed: 0 };
let fieldChanged = (): void => undefined;

/** Have something done after each change of the field at the probe. */
export function onField(act: () => void): void {
  fieldChanged = act;
}

export function start({ middle }: Medium): void {
  point = middle;
  field = force = new Float64Array(5);
}

/** Whether the force on the hand is shown, and not the bare force of the field. */
export const isHand = (): boolean => hand.rendered !== null && medium?.what === "decoded" && !isFollowing;

export const reading = (): Reading => ({ point, force, walked: walk.walked, extremes: walk.extremes });

/** Put the probe where a ray from the middle of the view first meets a force. */
export async function land(): Promise<void> {
  walk.leave();
  const met = await decoder.request<Met | null>({ do: "contact", time: 0, rays: view.raysFromMiddle(), depth: depthOf(medium!), away: view.away() });
  stamp("felt");
  entry = met?.entry ?? null;
  move(met?.point ?? point, met?.force ?? new Float64Array(5), entry);
}

/** Feel the field at the point of the box that is nearest to a point, or on the surface there. */
export async function feelAt(target: Triple, isFollowed = false, isLifted = false): Promise<void> {
  const bounded = medium!.bounded(target);
  isFollowing = isFollowed;
  if (walk.isActive() && !isFollowed) return walkTo(bounded);
  walk.leave();
  move(bounded, await fieldAt(bounded), isLifted ? bounded : null);
}

/** The same for the latest of several points; errors are reported. */
export const feel = latest((target: Triple) => feelAt(target));

/** Put the probe on the surface in front of or behind a point. */
export async function walkTo(target: Triple): Promise<void> {
  const place = await walk.find(target);
  if (place) move(place.point, place.field, place.before);
}

/** Put the probe where a pointer's ray has met a force. */
export function meet(met: Met): void {
  isFollowing = false;
  walk.leave();
  move(met.point, met.force, met.entry);
}

/** Feel the field again, which has changed around the probe. */
export async function feelAgain(): Promise<void> {
  showField(await fieldAt(point));
}

export function showForce(): void {
  const rendered = isHand() ? hand.rendered : null;
  force = rendered ? Float64Array.of(...rendered.force, ...field.subarray(3)) : field;
  forcePanel.show(medium!, reading(), rendered?.isInContact ? rendered.proxy : null, slideSpeed());
}

const fieldAt = (target: Triple): Promise<Float64Array> => decoder.request({ do: "feel", points: target });

/** The probe is at a point, with this field; over a long way it is lifted, and put down at `from`, if that is given. */
function move(target: Triple, there: Float64Array, from: Triple | null): void {
  const moved = Math.hypot(...target.map((v, n) => v - point[n]!));
  const isLifted = from !== null && moved > LIFTED * Math.hypot(...medium!.lengths);
  measureSpeed(moved);
  point = target;
  hand.move(point, isLifted ? from : null);
  showField(there);
  if (view.isFlat) slice.moveThrough(point);
}

function showField(there: Float64Array): void {
  field = there;
  if (!isHand()) showForce();
  fieldChanged();
}

/** Metres a second at which the probe slides; 0 in a pause. */
function slideSpeed(): number {
  return performance.now() / 1000 - latestMove.at < PAUSE_S ? latestMove.speed : 0;
}

function measureSpeed(metres: number): void {
  const now = performance.now() / 1000;
  const passed = now - latestMove.at;
  latestMove = { at: now, speed: passed > PAUSE_S || passed <= 0 ? 0 : metres / passed };
}
