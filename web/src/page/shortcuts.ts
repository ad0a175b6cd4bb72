// The keys of the page, and the list of keys that it shows as help.
import { byId, nudge } from "../elements";
import type { Triple } from "../engine";
import { keyList } from "../panel";
import * as announcer from "./announcer";
import * as bookmark from "./bookmark";
import * as clock from "./clock";
import * as fieldChoice from "./field_choice";
import * as frames from "./frames";
import * as jumps from "./jumps";
import { medium } from "./medium";
import * as opening from "./opening";
import * as player from "./player";
import * as probeControls from "./probe_controls";
import { saveFrames } from "./save_controls";
import * as slice from "./slice";
import * as soundControls from "./sound_controls";
import * as steps from "./steps";
import { decoder } from "./threads";
import * as viewControls from "./view_controls";

type Acts = Record<string, () => void>;

const SLICE_STEP = 12; // thousandths of the slider
const ZOOM = 1.15;

const TIME: Acts = {
  " ": () => player.setPlaying(!clock.isPlaying && !!medium && medium.head.frames > 1),
  ",": () => medium && frames.show(clock.time - 1 / medium.head.rate),
  ".": () => medium && frames.show(clock.time + 1 / medium.head.rate),
  Home: () => medium && frames.show(0),
  End: () => medium && frames.show(medium.seconds),
};

const PROBE: Acts = {
  "<": () => steps.deepen(-1),
  ">": () => steps.deepen(1),
  f: probeControls.toggleSurface,
  n: bookmark.mark,
  b: bookmark.goBack,
  l: bookmark.writeAddress,
  j: () => jumps.press(0),
  k: () => jumps.press(1),
  m: soundControls.toggle,
  v: soundControls.toggleRumble,
  s: soundControls.scan,
  t: () => medium && void decoder.request({ do: "feel", points: [] }).then(() => announcer.speak(true)), // after the moves that are under way
};

const VIEW: Acts = {
  "[": () => nudge("cut", -SLICE_STEP),
  "]": () => nudge("cut", SLICE_STEP),
  x: () => slice.turnTo(0),
  y: () => slice.turnTo(1),
  z: () => slice.turnTo(2),
  c: viewControls.toggleCut,
  "+": () => viewControls.turn(0, 0, ZOOM),
  "=": () => viewControls.turn(0, 0, ZOOM),
  "-": () => viewControls.turn(0, 0, 1 / ZOOM),
  a: () => viewControls.turn(-0.12, 0),
  d: () => viewControls.turn(0.12, 0),
  w: () => viewControls.turn(0, 0.1),
  q: () => viewControls.turn(0, -0.1),
  r: viewControls.turnBack,
  h: viewControls.toggleContrast,
  e: fieldChoice.chooseNext,
};

const FILE_AND_HELP: Acts = {
  o: opening.choose,
  p: () => void saveFrames(false),
  "?": () => toggleHelp(),
  Escape: () => toggleHelp(true),
};

const ACTS: Acts = { ...TIME, ...PROBE, ...VIEW, ...FILE_AND_HELP };

function toggleHelp(isClosed = false): void {
  const help = byId("help");
  help.hidden = isClosed || !help.hidden;
  byId("keys").setAttribute("aria-expanded", String(!help.hidden));
}

/** The direction in which a key moves the probe, and its sign. */
function moveOf(key: string): [Triple, number] | undefined {
  const { right, up, towards } = medium!.directions;
  const moves: Record<string, [Triple, number]> = {
    ArrowRight: [right, 1], ArrowLeft: [right, -1], ArrowUp: [up, 1], ArrowDown: [up, -1], PageUp: [towards, -1], PageDown: [towards, 1],
  };
  return moves[key];
}

/** Whether a key is one of the control that has the focus: a letter goes through a slider, and not through a list. */
function isForControl({ key, target }: KeyboardEvent): boolean {
  const { tagName } = target as HTMLElement;
  return tagName === "SELECT" || (tagName === "INPUT" && key.length !== 1) || (/^(BUTTON|SUMMARY)$/.test(tagName) && key === " ");
}

function onKey(event: KeyboardEvent): void {
  const { key, target } = event;
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const isControl = /^(INPUT|SELECT)$/.test((target as HTMLElement).tagName);
  const move = medium && !isControl ? moveOf(key) : undefined;
  const act = isForControl(event) ? undefined : ACTS[key] ?? ACTS[key.toLowerCase()];
  if (move) steps.step(...move, event.shiftKey);
  else if (act) act();
  else return;
  event.preventDefault();
}

export function wire(): void {
  byId("keys").onclick = (): void => toggleHelp();
  keyList(byId("help"));
  document.addEventListener("keydown", onKey);
}

/** Press a key in place of a button of a game pad. */
export function press(key: string): void {
  document.body.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true }));
}
