// Shows the frame of an instant: its surfaces and bodies, the slice, the clock, and the field at the probe.
import type { Shown, Triple } from "../engine";
import * as clock from "./clock";
import { depthOf } from "./depth";
import * as handLink from "./hand_link";
import { medium, type Medium } from "./medium";
import { view } from "./outputs";
import * as probe from "./probe";
import * as slice from "./slice";
import { latest, stamp, timings } from "./status";
import * as walk from "./surface_walk";
import { decoder } from "./threads";

/** Bytes of the decoder. */
export let memory = 0;
/** The point with the strongest force of the frame that is shown. */
export let strongest: Triple = [0, 0, 0];

export function start({ opened }: Medium): void {
  memory = opened.memory;
}

/** Show the latest of several instants; errors are reported. */
export const show = latest((time: number) => showNow(time));

/** Show an instant, seconds; the first one of a medium puts the probe onto its surface. */
export async function showNow(time: number, isFirst = false): Promise<void> {
  const current = medium!;
  clock.setTime(Math.min(Math.max(time, 0), current.seconds));
  handLink.keepTime();
  if (current.isRemote) await current.fetch(clock.time);
  if (current !== medium) return;
  if (isFirst) await probe.land();
  const at = isFirst && !view.isFlat ? null : slice.position; // the decoder lays the first slice
  const shown = await decoder.request<Shown>({ do: "show", time: clock.time, axis: slice.axis, at, depth: depthOf(current) });
  if (current !== medium) return;
  memory = shown.memory;
  if (shown.largest[0]! > 0) strongest = strongestOf(shown);
  view.show(shown);
  stampShown(isFirst);
  clock.show(current);
  slice.follow(shown);
  if (walk.isActive() && !clock.isPlaying) return probe.walkTo(probe.point);
  walk.leave();
  if (!isFirst) await probe.feelAgain();
}

/** Where a frame pushes most, metres in the workspace: the point of a body is turned and moved by its pose. */
function strongestOf({ poses, largest }: Shown): Triple {
  return [0, 1, 2].map((row) => poses[3 * row]! * largest[1]! + poses[3 * row + 1]! * largest[2]! + poses[3 * row + 2]! * largest[3]! + poses[9 + row]!) as Triple;
}

function stampShown(isFirst: boolean): void {
  if (!("drawn" in timings) || isFirst) view.onDrawn = (): void => {
    stamp("drawn");
    view.onDrawn = null;
  };
  stamp("shown");
}
