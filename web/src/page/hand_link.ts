// Gives the hand the file that is open, and shows how it renders it.
import { setText } from "../elements";
import * as clock from "./clock";
import { medium } from "./medium";
import * as probe from "./probe";
import { hand } from "./threads";

const MAX_HAND_BYTES = 1 << 26;

export function wire(): void {
  hand.onReport = show;
}

/** Give the hand a file, if it is all there; from then on the force is the one that it renders. */
export function start(data: Uint8Array | null, isContinued = false): void {
  const reason = reasonAgainst(data);
  if (!data || reason) {
    hand.close(reason);
    return show();
  }
  hand.open(data, isContinued);
  hand.move(probe.point, probe.entry ?? probe.point);
  keepTime();
}

/** Why there is no hand; empty if there can be one. */
function reasonAgainst(data: Uint8Array | null): string {
  if (medium!.isArray) return "an array of actuators is not touched with a probe";
  if (!data) return "the file is read in parts";
  return data.length > MAX_HAND_BYTES ? "the file is too large" : "";
}

/** Pass on the time and speed of the page, whose player is the clock. */
export function keepTime(): void {
  hand.follow(clock.time, clock.currentSpeed());
}

/** Show the latest report of the hand. */
function show(): void {
  if (!medium) return;
  const { rendered, fault } = hand;
  const ticks = rendered?.hertz ? `${rendered.hertz} ticks a second` : "starts";
  setText("hand", fault ? `none, ${fault}: the force of the field is shown` : `${ticks}${rendered?.missed ? `, ${rendered.missed} left out` : ""}`);
  if (probe.isHand() || fault) probe.showForce();
}
