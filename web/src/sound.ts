// Turns the force at the probe into sound, into rumble of a game pad, and into vibration of a phone.

export class Sound {
  private context: AudioContext | null = null;
  private tone: OscillatorNode | null = null;
  private loudness: GainNode | null = null;
  private side: StereoPannerNode | null = null;
  private rumbles = false;
  private latest = 0;
  /** The latest output, for tests. */
  output = { hertz: 0, loudness: 0, side: 0 };

  get isOn(): boolean {
    return this.context !== null && this.context.state !== "suspended";
  }

  get isRumbling(): boolean {
    return this.rumbles;
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
    this.rumbles = on;
    if (!on) navigator.vibrate?.(0);
  }

  /** A force as a fraction of the largest, its side from -1 (left) to 1, and a vibration. */
  play(fraction: number, side: number, vibration: number, hertz: number): void {
    const level = Math.min(Math.max(fraction, 0), 1);
    this.output = { hertz: hertz > 0 ? hertz : 110 * 2 ** (3.5 * level), loudness: level > 0 ? 0.04 + 0.3 * level : 0, side };
    if (this.context && this.tone && this.loudness && this.side) {
      const now = this.context.currentTime;
      this.tone.frequency.setTargetAtTime(this.output.hertz, now, 0.015);
      this.loudness.gain.setTargetAtTime(this.output.loudness, now, 0.015);
      this.side.pan.setTargetAtTime(Math.min(Math.max(side, -1), 1), now, 0.03);
    }
    const now = performance.now();
    if (!this.rumbles || now - this.latest < 60) return;
    this.latest = now;
    for (const pad of navigator.getGamepads?.() ?? [])
      void pad?.vibrationActuator
        ?.playEffect("dual-rumble", { duration: 120, strongMagnitude: level, weakMagnitude: Math.min(1, vibration) })
        .catch(() => undefined);
    if (level > 0.02) navigator.vibrate?.([Math.round(8 + 40 * level), Math.round(50 - 40 * level)]);
    else navigator.vibrate?.(0);
  }
}
