// Plays a medium: shows the instant that is due at each frame of the screen; with its button and its slider.
import { byId, input, setPressed, setText } from "../elements";
import * as clock from "./clock";
import * as frames from "./frames";
import * as handLink from "./hand_link";
import { medium } from "./medium";
import * as movie from "./movie";
import * as probe from "./probe";
import { isPageState, latest, onFault, reportFault } from "./status";
import * as walk from "./surface_walk";

const AHEAD_S = 1; // of playing: so much of a remote file is fetched ahead
const SLOW_STEP_S = 0.25;

/** Number of the last loop of steps: an earlier one, which may still wait for its frame, ends. */
let lastLoop = 0;

export function wire(): void {
  byId("play").onclick = toggle;
  byId("at").oninput = (): void => seek(Number(input("at").value));
  onFault(() => clock.setPlaying(false));
}

export function toggle(): void {
  setPlaying(!clock.isPlaying);
}

export function setPlaying(on: boolean): void {
  clock.setPlaying(on);
  if (medium) handLink.keepTime();
  if (on) movie.play(clock.chosenSpeed()).catch(() => setPlaying(false));
  else movie.pause();
  setPressed("play", on);
  setText("play", on ? "Pause" : "Play");
  if (!medium) return;
  if (on) void step(performance.now(), ++lastLoop);
  else if (walk.isActive() && isPageState("ready")) probe.feel(probe.point); // while it played, the probe left the surface
}

function seek(time: number): void {
  setPlaying(false);
  if (!medium) return;
  movie.seek(time);
  frames.show(time);
}

/** Show what is due; `before` is the time of the step before, milliseconds, and `loop` that of the steps. */
async function step(before: number, loop: number): Promise<void> {
  if (!clock.isPlaying || loop !== lastLoop || !medium) return;
  const now = performance.now();
  const time = timeAfter((now - before) / 1000, medium.seconds);
  try {
    await frames.showNow(time);
    if (medium.isRemote) fetchAhead(Math.min(time + AHEAD_S * clock.speed(), medium.seconds));
  } catch (error) {
    return reportFault(error);
  }
  adaptPace((performance.now() - now) / 1000);
  requestAnimationFrame(() => void step(now, loop));
}

/** The time that is due; after the end the medium starts again, unless a movie is the clock. */
function timeAfter(passed: number, end: number): number {
  const movieTime = movie.time();
  if (movieTime !== null) return Math.min(Math.max(movieTime, 0), end);
  const time = clock.time + passed * clock.speed();
  return time > end ? 0 : time;
}

const fetchAhead = latest((time: number) => medium!.fetch(time));

/** Where a step takes longer to decode than to play, steps are kept short: it plays slower, and does not jump. */
function adaptPace(seconds: number): void {
  clock.setPace(seconds > SLOW_STEP_S ? Math.max(clock.pace * 0.7, 1 / 64) : Math.min(clock.pace * 1.1, 1));
  byId("play").title = clock.pace < 0.9 ? `slower than requested: decoding takes longer` : "Space";
}
