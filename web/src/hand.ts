// The hand: the receiver of c/touch_play.h in WebAssembly, in a worker of its own. It ticks a thousand times a
// second: a timer of a browser wakes it every few milliseconds, and it computes the ticks that are due since.
import type { Triple } from "./engine";

interface Exports {
  memory: WebAssembly.Memory;
  room(bytes: number): number;
  message(): number;
  hand_open(): number;
  hand_close(): void;
  hand_move(x: number, y: number, z: number, isLifted: number, fromX: number, fromY: number, fromZ: number): void;
  hand_follow(time: number, speed: number): void;
  hand_run(ms: number): void;
  hand_decode(): number;
  hand_report(): number;
}

/** What the receiver rendered since the last report. */
export interface Rendered {
  /** Mean of the force on the hand, newtons. */
  force: Triple;
  /** The point that stays on the surface, and the device, metres. */
  proxy: Triple;
  device: Triple;
  isInContact: boolean;
  /** Seconds of the medium. */
  time: number;
  /** Ticks in the last second, and those that were left out since the start. */
  hertz: number;
  missed: number;
}

/** What the page tells the hand. A file that is opened has a number, which its answers have, too. */
export type HandOrder =
  | { do: "open"; file: number; module: WebAssembly.Module; data: Uint8Array }
  | { do: "close" }
  | { do: "move"; point: Triple; from: Triple | null }
  | { do: "follow"; time: number; speed: number }
  | { do: "rest"; isResting: boolean };

/** A report, or why there is none. */
export interface HandAnswer {
  file: number;
  rendered: Rendered | null;
  fault: string;
}

export const PAGE_MATH = {
  sin: Math.sin, cos: Math.cos, atan: Math.atan, atan2: Math.atan2, asin: Math.asin, acos: Math.acos, log2: Math.log2,
  exp: Math.exp, expm1: Math.expm1, pow: Math.pow,
};

const WAKE_MS = 1; // browsers make it four
const DECODE_MS = 3;
const REPORT_MS = 15;
const STILL_MS = 100; // between reports where nothing changes
const ALIKE = [1e-4, 1e-6]; // newtons, metres

/** The side of the worker. */
export class HandWorker {
  private wasm: Exports | null = null;
  private file = 0;
  private timer = 0;
  private isOpen = false;
  private reported = 0;
  private counted = { at: 0, ticks: 0, hertz: 0 };
  private latest: Rendered | null = null;

  constructor(private readonly send: (answer: HandAnswer) => void) {}

  take(order: HandOrder): void {
    if (order.do === "open") this.open(order);
    else if (order.do === "close") this.close();
    else if (order.do === "rest") this.wakes(!order.isResting);
    else if (!this.wasm) return;
    else if (order.do === "follow") this.wasm.hand_follow(order.time, order.speed);
    else this.wasm.hand_move(...order.point, Number(!!order.from), ...(order.from ?? order.point));
  }

  private open({ file, module, data }: HandOrder & { do: "open" }): void {
    this.close();
    this.file = file;
    this.wasm ??= new WebAssembly.Instance(module, { page: PAGE_MATH }).exports as unknown as Exports;
    const at = this.wasm.room(data.length);
    if (at) new Uint8Array(this.wasm.memory.buffer).set(data, at);
    if (!at || this.wasm.hand_open()) return this.fail(at ? this.message() : "the file is too large");
    this.isOpen = true;
    this.wakes(true);
  }

  private close(): void {
    this.wakes(false);
    this.isOpen = false;
    this.latest = null;
    this.wasm?.hand_close();
  }

  private fail(fault: string): void {
    this.close();
    this.send({ file: this.file, rendered: null, fault });
  }

  private wakes(on: boolean): void {
    clearInterval(this.timer);
    this.counted = { at: performance.now(), ticks: 0, hertz: 0 };
    if (on && this.isOpen) this.timer = setInterval(() => this.wake(), WAKE_MS) as unknown as number;
  }

  private wake(): void {
    const now = performance.now();
    this.wasm!.hand_run(now);
    while (performance.now() - now < DECODE_MS && this.wasm!.hand_decode());
    if (now - this.reported >= REPORT_MS) this.report(now);
  }

  private report(now: number): void {
    const n = new Float64Array(this.wasm!.memory.buffer, this.wasm!.hand_report(), 14);
    const three = (i: number): Triple => [n[i]!, n[i + 1]!, n[i + 2]!];
    if (n[12]) return this.fail(this.message());
    if (!n[10]) return; // no tick was due
    this.counted.ticks += n[10]!;
    const seconds = (now - this.counted.at) / 1000;
    if (seconds >= 1) this.counted = { at: now, ticks: 0, hertz: Math.round(this.counted.ticks / seconds) };
    const { hertz } = this.counted;
    const rendered = { force: three(0), proxy: three(3), device: three(6), isInContact: !!n[9], time: n[11]!, hertz, missed: n[13]! };
    const isAlike = this.latest?.hertz === hertz && this.latest.isInContact === rendered.isInContact && (["force", "proxy", "device"] as const)
      .every((key) => rendered[key].every((v, k) => Math.abs(v - this.latest![key][k]!) <= ALIKE[Number(key !== "force")]!));
    if (isAlike && now - this.reported < STILL_MS) return;
    this.reported = now;
    this.latest = rendered;
    this.send({ file: this.file, rendered, fault: "" });
  }

  private message(): string {
    const bytes = new Uint8Array(this.wasm!.memory.buffer);
    let text = "";
    for (let at = this.wasm!.message(); bytes[at]; at++) text += String.fromCharCode(bytes[at]!);
    return text;
  }
}

/** The side of the page. */
export class Hand {
  /** The latest report on the file that is open. */
  rendered: Rendered | null = null;
  /** Why there is no hand. */
  fault = "";
  /** Runs after each report, and where there is no hand. */
  onReport = (): void => undefined;
  private module: WebAssembly.Module | null = null;
  private worker: Worker | null = null;
  private file = 0;

  /** A file is opened once the module is compiled: the decoder, which needs the same one, has opened it before. */
  constructor(module: Promise<WebAssembly.Module>, private readonly script: string) {
    module.then((compiled) => (this.module = compiled), () => undefined);
    document.addEventListener("visibilitychange", () => this.order({ do: "rest", isResting: document.hidden }));
  }

  /** Open a file; one that continues the one before leaves the last report until its own first one. */
  open(data: Uint8Array, isContinued: boolean): void {
    const { rendered } = this;
    this.close();
    if (isContinued) this.rendered = rendered;
    try {
      this.worker ??= new Worker(this.script);
      this.worker.onmessage = ({ data: { file, rendered, fault } }: MessageEvent<HandAnswer>): void => {
        if (file !== this.file) return;
        this.rendered = rendered;
        this.fault = fault;
        this.onReport();
      };
      this.worker.onerror = (): void => this.none("no worker is allowed");
      this.order({ do: "open", file: this.file, module: this.module!, data });
    } catch {
      this.none("no worker is allowed");
    }
  }

  private none(fault: string): void {
    this.worker = this.rendered = null;
    this.fault = fault;
    this.onReport();
  }

  close(fault = ""): void {
    this.file++;
    this.rendered = null;
    this.fault = fault;
    this.order({ do: "close" });
  }

  move(point: Triple, from: Triple | null): void {
    this.order({ do: "move", point, from });
  }

  /** The page is at a time, and plays with a speed; 0: it stands. */
  follow(time: number, speed: number): void {
    this.order({ do: "follow", time, speed });
  }

  private order(order: HandOrder): void {
    this.worker?.postMessage({ hand: order });
  }
}
