// Turns the force at the probe into sound, into rumble of a game pad, and into vibration of a phone.
export const RENEW_MS = 100; // an effect is renewed long before it ends, so that a force that stays has no gaps
const EFFECT_MS = 300;
const LEAST_MS = 40; // between two effects
const EMPHASIS_MS = 60;
const CONTACT = 0.02; // fraction of the largest force

interface Effect {
  level: number;
  side: number;
  vibration: number;
}

export class Sound {
  private context: AudioContext | null = null;
  private tone: OscillatorNode | null = null;
  private loudness: GainNode | null = null;
  private side: StereoPannerNode | null = null;
  private timer = 0;
  private latest = 0;
  private contactAt = -Infinity;
  private effect: Effect = { level: 0, side: 0, vibration: 0 };
  private isRunning = false;
  /** What loudness and rumble are multiplied by. */
  gain = 1;
  /** The latest output, for tests. */
  output = { hertz: 0, loudness: 0, side: 0 };

  constructor() {
    document.addEventListener("visibilitychange", () => document.hidden && this.rest());
    addEventListener("pagehide", () => this.rest());
  }

  get isOn(): boolean {
    return this.context !== null && this.context.state !== "suspended";
  }

  get isRumbling(): boolean {
    return this.timer !== 0;
  }

  async sound(on: boolean): Promise<void> {
    if (!on) return void (await this.context?.suspend());
    if (!this.context) {
      this.context = new AudioContext();
      this.tone = this.context.createOscillator();
      this.loudness = this.context.createGain();
      this.side = this.context.createStereoPanner();
      this.loudness.gain.value = 0;
      this.tone.type = "triangle";
      this.tone.connect(this.loudness).connect(this.side).connect(this.context.destination);
      this.tone.start();
    }
    await this.context.resume();
  }

  rumble(on: boolean): void {
    window.clearInterval(this.timer);
    this.timer = on ? window.setInterval(() => this.shake(), RENEW_MS) : 0;
    if (on) this.shake();
    else this.rest();
  }

  /** A force as a fraction of the largest, its side from -1 (left) to 1, and a vibration. */
  play(fraction: number, side: number, vibration: number, hertz: number): void {
    const level = Math.min(Math.max(fraction, 0), 1);
    const now = performance.now();
    if (level > CONTACT && this.effect.level <= CONTACT) this.contactAt = now;
    this.effect = { level, side: Math.min(Math.max(side, -1), 1), vibration: Math.min(vibration, 1) };
    this.output = { hertz: hertz > 0 ? hertz : 110 * 2 ** (3.5 * level), loudness: level > 0 ? this.gain * (0.04 + 0.3 * level) : 0, side };
    if (this.context && this.tone && this.loudness && this.side) {
      const at = this.context.currentTime;
      this.tone.frequency.setTargetAtTime(this.output.hertz, at, 0.015);
      this.loudness.gain.setTargetAtTime(this.output.loudness, at, 0.015);
      this.side.pan.setTargetAtTime(this.effect.side, at, 0.03);
    }
    if (this.isRumbling && now - this.latest >= LEAST_MS) this.shake();
  }

  /** Start the effect of the present force, in place of the one before. */
  private shake(): void {
    const level = this.gain * this.effect.level;
    const now = performance.now();
    const isContact = now - this.contactAt < EMPHASIS_MS; // a surface that is met is felt as a short knock
    const weak = Math.max(Math.min(1, this.gain * this.effect.vibration), isContact ? this.gain : 0);
    if (document.hidden || !(level > 0 || weak > 0)) return this.rest();
    this.latest = now;
    this.isRunning = true;
    for (const pad of navigator.getGamepads?.() ?? []) shakePad(pad, level, weak, this.effect.side);
    if (level <= CONTACT) return void navigator.vibrate?.(0);
    const [on, off] = [Math.round(8 + 40 * level), Math.round(50 - 40 * level)];
    navigator.vibrate?.(Array.from({ length: 2 * Math.ceil(EFFECT_MS / (on + off)) }, (_, n) => (n % 2 ? off : on)));
  }

  private rest(): void {
    if (!this.isRunning) return;
    this.isRunning = false;
    for (const pad of navigator.getGamepads?.() ?? []) void pad?.vibrationActuator?.reset?.();
    navigator.vibrate?.(0);
  }
}

/** Rumble of a pad; where its triggers have motors, the trigger on the side to which the force points rumbles, too. */
export function shakePad(pad: Gamepad | null, strong: number, weak: number, side: number): void {
  const actuator = pad?.vibrationActuator as (GamepadHapticActuator & { effects?: string[] }) | null | undefined;
  if (!actuator?.playEffect) return;
  const effect = { duration: EFFECT_MS, strongMagnitude: strong, weakMagnitude: weak };
  const triggers = { leftTrigger: strong * Math.max(0, -side), rightTrigger: strong * Math.max(0, side) };
  const played = actuator.effects?.includes("trigger-rumble")
    ? actuator.playEffect("trigger-rumble" as GamepadHapticEffectType, { ...effect, ...triggers })
    : actuator.playEffect("dual-rumble", effect);
  void played.catch(() => undefined);
}
