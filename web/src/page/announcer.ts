// Speaks what is under the probe, at most once in a while, for those who do not see.
import { say } from "../speech";
import * as clock from "./clock";
import { medium } from "./medium";
import * as probe from "./probe";
import { spokenText } from "./reading";

const SPOKEN_MS = 1200; // between two sentences
const REST_MS = 250; // the probe has rested so long before a sentence

let spokenAt = 0;
let timer = 0;

/** Speak once the probe rests, and the sentence before is over. */
export function speakSoon(): void {
  const wait = SPOKEN_MS - (performance.now() - spokenAt);
  window.clearTimeout(timer);
  timer = window.setTimeout(() => speak(), Math.max(wait, REST_MS));
}

/** Speak now; while the medium plays only if a user requests it. */
export function speak(isRequested = false): void {
  if (!medium || (clock.isPlaying && !isRequested)) return;
  spokenAt = performance.now();
  say(spokenText(probe.reading(), medium));
}

/** Say another sentence in place of what would be spoken soon. */
export function sayInstead(sentence: string): void {
  window.clearTimeout(timer);
  spokenAt = performance.now();
  say(sentence);
}
