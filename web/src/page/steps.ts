// Steps of the probe, by keys and by the stick of a game pad; over a surface they move it as over a map.
import { nudge } from "../elements";
import type { Triple } from "../engine";
import { along, medium } from "./medium";
import * as probe from "./probe";
import { latest } from "./status";
import * as walk from "./surface_walk";

const DEPTH_STEP = 4; // percent of the slider

/** Metres along x, y and z that were requested since the probe last moved. */
let due: Triple = [0, 0, 0];

/** Leave out what is still due: the probe goes elsewhere. */
export function forget(): void {
  due = [0, 0, 0];
}

/** Press the probe in more deeply (1), or less (-1). */
export function deepen(sign: number): void {
  nudge("depth", sign * DEPTH_STEP);
}

/** A step of a key. On a surface seen from above, up is ahead; on one seen from the front, away is deeper. */
export function step(direction: Triple, sign: number, isFine: boolean): void {
  walk.setFine(isFine);
  const { outward, ahead } = medium!.directions;
  const [axis, directionSign] = along(direction);
  const isOutward = walk.isActive() && axis === along(outward)[0];
  if (isOutward && !walk.isFromAbove()) return deepen(directionSign * sign === along(outward)[1] ? -1 : 1);
  shift(isOutward ? ahead : direction, sign * medium!.step(isOutward ? along(ahead)[0] : axis, isFine));
}

/** A stick moves the probe by fractions of the box: to the right, up and towards the viewer. */
export function moveByPad(right: number, up: number, towards: number): void {
  if (!medium) return;
  walk.setFine(false);
  const { directions, lengths } = medium;
  const upwards = walk.isActive() && walk.isFromAbove() ? directions.ahead : directions.up;
  for (const [direction, fraction] of [[directions.right, right], [upwards, up], [directions.towards, walk.isActive() ? 0 : towards]] as const)
    if (fraction) shift(direction, fraction * lengths[along(direction)[0]]!);
}

/** Move the probe along one of the viewer's directions, metres. */
function shift(direction: Triple, metres: number): void {
  direction.forEach((v, n) => (due[n]! += v * metres));
  apply();
}

/** Move the probe by what is due; of an array what is less than a step to the next actuator waits. */
const apply = latest(async () => {
  const { head: { spacing }, isArray } = medium!;
  const by = due.map((metres, n) => (isArray ? spacing[n]! * Math.round(metres / spacing[n]!) : metres)) as Triple;
  due = due.map((metres, n) => metres - by[n]!) as Triple;
  await probe.feelAt(probe.point.map((v, n) => v + by[n]!) as Triple);
});
