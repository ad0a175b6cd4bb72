// Plays the level of a moment on game pads and phones, in time with the movie. A timer looks at the movie's clock far more
// often than the picture changes, so that an onset waits for no drawing.
import { RENEW_MS, shakePad } from "./sound";
import type { Level } from "./timeline_track";

const LOOK_MS = 4;
const MIN_MS = 20; // between effects that only vary
const CHANGE = 0.03; // that is an effect of its own
const ONSET = 0.08; // that is played at once
const PHONE_MIN = 0.02;
const PHONE_MS = 300;
const STILL: Level = { strong: 0, weak: 0, side: 0 };

export class Output {
  /** By what levels are multiplied. */
  gain = 1;
  isOn = true;
  private timer = 0;
  private sent = STILL;
  private sentAt = -Infinity;

  /** `level` gives that of the present instant. */
  constructor(private readonly level: () => Level) {
    document.addEventListener("visibilitychange", () => document.hidden && this.rest());
    addEventListener("pagehide", () => this.stop());
  }

  start(): void {
    window.clearInterval(this.timer);
    this.timer = window.setInterval(() => this.look(), LOOK_MS);
  }

  stop(): void {
    window.clearInterval(this.timer);
    this.timer = 0;
    this.rest();
  }

  /** Play the present level, if it differs from the one that is played, or that one is about to end. */
  private look(): void {
    if (!this.isOn || document.hidden) return this.rest();
    const { strong, weak, side } = this.level();
    const level = { strong: Math.min(1, this.gain * strong), weak: Math.min(1, this.gain * weak), side };
    const rise = Math.max(level.strong - this.sent.strong, level.weak - this.sent.weak);
    const change = Math.max(rise, this.sent.strong - level.strong, this.sent.weak - level.weak);
    const waited = performance.now() - this.sentAt;
    const isStill = !level.strong && !level.weak;
    if (isStill) return this.rest();
    if (rise > ONSET || (change > CHANGE && waited >= MIN_MS) || waited >= RENEW_MS) this.play(level);
  }

  private play(level: Level): void {
    this.sent = level;
    this.sentAt = performance.now();
    for (const pad of navigator.getGamepads?.() ?? []) shakePad(pad, level.strong, level.weak, level.side);
    const loudest = Math.max(level.strong, level.weak);
    // a phone has one strength: shorter pulses are weaker
    const [on, off] = [Math.round(8 + 40 * loudest), Math.round(50 - 40 * loudest)];
    const pulses = Array.from({ length: 2 * Math.ceil(PHONE_MS / (on + off)) }, (_, n) => (n % 2 ? off : on));
    navigator.vibrate?.(loudest > PHONE_MIN ? pulses : 0);
  }

  private rest(): void {
    if (this.sent === STILL) return;
    this.sent = STILL;
    this.sentAt = -Infinity;
    for (const pad of navigator.getGamepads?.() ?? []) void pad?.vibrationActuator?.reset?.();
    navigator.vibrate?.(0);
  }
}
