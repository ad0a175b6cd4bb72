// Reads how a file describes its axes ("x right, y up, z towards the viewer"), so that the page draws it the
// right way up.
import type { Triple } from "./engine";

const DIRECTIONS: Record<string, [number, number]> = {
  right: [0, 1], east: [0, 1], left: [0, -1], west: [0, -1], up: [1, 1], down: [1, -1], towards: [2, 1], toward: [2, 1],
  back: [2, 1], backwards: [2, 1], away: [2, -1], forward: [2, -1], forwards: [2, -1],
};

export interface Directions {
  right: Triple;
  up: Triple;
  towards: Triple;
  /** Where a finger comes from to the surface, and what lies ahead of it there: of a map from above, and north. */
  outward: Triple;
  ahead: Triple;
  names: [string, string, string];
}

const unit = (axis: number, sign: number): Triple => [0, 1, 2].map((n) => (n === axis ? sign : 0)) as Triple;

const cross = (a: Triple, b: Triple): Triple => [
  a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0],
];

const negative = (a: Triple): Triple => a.map((n) => -n || 0) as Triple;

/** Directions with those of a finger: from the camera of a picture and to an array from the front, to all else from above. */
function withFinger(directions: Omit<Directions, "outward" | "ahead">, isFromFront: boolean): Directions {
  const { up, towards } = directions;
  return isFromFront ? { ...directions, outward: towards, ahead: up } : { ...directions, outward: up, ahead: negative(towards) };
}

/** Directions of the axes; y of an array, whose lattice hangs before the viewer, is up unless the text says down. */
export function directionsOf(text: string, isArray: boolean): Directions {
  const names: [string, string, string] = ["", "", ""];
  const found: (Triple | null)[] = [null, null, null];
  for (const part of text.split(",")) {
    const match = /^\s*([xyz])\s+(\S+)/i.exec(part);
    if (!match) continue;
    const axis = "xyz".indexOf(match[1]!.toLowerCase());
    names[axis] = match[2]!;
    const direction = DIRECTIONS[match[2]!.toLowerCase()];
    if (direction && !found[direction[0]]) found[direction[0]] = unit(axis, direction[1]);
  }
  if (isArray) {
    const up = /y\s+down/i.test(text) ? unit(1, -1) : unit(1, 1);
    return withFinger({ right: unit(0, 1), up, towards: /z\s+forward/i.test(text) ? unit(2, -1) : unit(2, 1), names }, true);
  }
  const up = found[1] ?? unit(1, 1);
  let right = found[0] ?? unit(up[0] ? 1 : 0, 1);
  if (right.some((n, k) => n && up[k])) right = unit(up[0] ? 1 : 0, 1);
  const towards = found[2] && !found[2].some((n, k) => n && (up[k] || right[k])) ? found[2] : cross(right, up);
  return withFinger({ right, up, towards, names }, names.some((name) => /^forwards?$/i.test(name))); // as a camera saw it
}

/** Text of a direction as the viewer sees it: "up and left". */
export function directionText(force: ArrayLike<number>, directions: Directions): string {
  const size = Math.hypot(force[0]!, force[1]!, force[2]!);
  const along = (direction: Triple): number => (direction[0] * force[0]! + direction[1] * force[1]! + direction[2] * force[2]!) / size;
  const parts: [number, string][] = [];
  for (const [direction, positive, negative] of [
    [directions.up, "up", "down"], [directions.right, "right", "left"], [directions.towards, "towards you", "away from you"],
  ] as const) {
    const fraction = along(direction);
    if (Math.abs(fraction) > 0.38) parts.push([Math.abs(fraction), fraction > 0 ? positive : negative]);
  }
  return parts.sort((a, b) => b[0] - a[0]).map((row) => row[1]).join(" and ");
}
