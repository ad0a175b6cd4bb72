// Reads how a file describes its axes ("x right, y up, z towards the viewer"), so that the page draws it the
// right way up.
import type { Triple } from "./engine";

const WAYS: Record<string, [number, number]> = {
  right: [0, 1], east: [0, 1], left: [0, -1], west: [0, -1], up: [1, 1], down: [1, -1], towards: [2, 1], toward: [2, 1],
  back: [2, 1], backwards: [2, 1], away: [2, -1], forward: [2, -1], forwards: [2, -1],
};

export interface Ways {
  right: Triple;
  up: Triple;
  towards: Triple;
  words: [string, string, string];
}

const unit = (axis: number, sign: number): Triple => [0, 1, 2].map((n) => (n === axis ? sign : 0)) as Triple;

const cross = (a: Triple, b: Triple): Triple => [
  a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0],
];

/** Ways of the axes; of an array, whose lattice hangs before the viewer, y is up unless its words say that it is down. */
export function waysOf(text: string, isArray: boolean): Ways {
  const words: [string, string, string] = ["", "", ""];
  const told: (Triple | null)[] = [null, null, null];
  for (const part of text.split(",")) {
    const match = /^\s*([xyz])\s+(\S+)/i.exec(part);
    if (!match) continue;
    const axis = "xyz".indexOf(match[1]!.toLowerCase());
    words[axis] = match[2]!;
    const way = WAYS[match[2]!.toLowerCase()];
    if (way && !told[way[0]]) told[way[0]] = unit(axis, way[1]);
  }
  if (isArray) {
    const up = /y\s+down/i.test(text) ? unit(1, -1) : unit(1, 1);
    return { right: unit(0, 1), up, towards: /z\s+forward/i.test(text) ? unit(2, -1) : unit(2, 1), words };
  }
  const up = told[1] ?? unit(1, 1);
  let right = told[0] ?? unit(up[0] ? 1 : 0, 1);
  if (right.some((n, k) => n && up[k])) right = unit(up[0] ? 1 : 0, 1);
  const towards = told[2] && !told[2].some((n, k) => n && (up[k] || right[k])) ? told[2] : cross(right, up);
  return { right, up, towards, words };
}

/** A direction in words of the viewer's: "up and left". */
export function directionWords(force: ArrayLike<number>, ways: Ways): string {
  const size = Math.hypot(force[0]!, force[1]!, force[2]!);
  const along = (way: Triple): number => (way[0] * force[0]! + way[1] * force[1]! + way[2] * force[2]!) / size;
  const told: [number, string][] = [];
  for (const [way, one, other] of [
    [ways.up, "up", "down"], [ways.right, "right", "left"], [ways.towards, "towards you", "away from you"],
  ] as const) {
    const share = along(way);
    if (Math.abs(share) > 0.38) told.push([Math.abs(share), share > 0 ? one : other]);
  }
  return told.sort((a, b) => b[0] - a[0]).map((row) => row[1]).join(" and ");
}
