// Game pads: a stick moves the probe, the cross moves it a step, and buttons do what keys do.
const DEAD = 0.15;
const BOXES_PER_S = 0.4; // of the box, at a full turn of the stick
const LEFT = { right: 0, ahead: 1 };
const RIGHT_STICK = 3;

/** Buttons of the standard layout, and the keys that they stand for. */
const KEYS: Record<number, string> = {
  0: "t", 1: "f", 2: "m", 3: "j", 4: "<", 5: ">", 8: "n", 9: " ", 10: "b", 12: "ArrowUp", 13: "ArrowDown", 14: "ArrowLeft", 15: "ArrowRight",
};

export class Pads {
  private pressed = new Set<string>();
  private before = 0;
  private isRunning = false;

  /** `move` gets fractions of the box to the right, up and towards the viewer; `press` the key of a button. */
  constructor(private readonly move: (right: number, up: number, towards: number) => void, private readonly press: (key: string) => void) {
    addEventListener("gamepadconnected", () => this.run());
    document.addEventListener("visibilitychange", () => this.run());
  }

  private run(): void {
    if (this.isRunning || document.hidden) return;
    this.isRunning = true;
    this.before = performance.now();
    requestAnimationFrame(() => this.poll());
  }

  private poll(): void {
    const pads = [...(navigator.getGamepads?.() ?? [])].filter((pad) => pad?.axes);
    this.isRunning = pads.length > 0 && !document.hidden;
    if (!this.isRunning) return;
    const now = performance.now();
    const far = (BOXES_PER_S * Math.min(now - this.before, 100)) / 1000;
    this.before = now;
    const down = new Set<string>();
    for (const pad of pads) {
      const [right, up, towards] = [turn(pad!.axes[LEFT.right]), -turn(pad!.axes[LEFT.ahead]), turn(pad!.axes[RIGHT_STICK])];
      if (right || up || towards) this.move(far * right, far * up, far * towards);
      for (const [n, key] of Object.entries(KEYS)) if (pad!.buttons?.[Number(n)]?.pressed) down.add(key);
    }
    for (const key of down) if (!this.pressed.has(key)) this.press(key);
    this.pressed = down;
    requestAnimationFrame(() => this.poll());
  }
}

/** A turn of a stick from -1 to 1, without its play around the middle. */
function turn(value = 0): number {
  return Math.abs(value) < DEAD ? 0 : (Math.sign(value) * (Math.min(Math.abs(value), 1) - DEAD)) / (1 - DEAD);
}
