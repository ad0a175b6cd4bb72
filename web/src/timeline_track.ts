// One track of touch: the drives of its actuators by frames, and what is left of them after the edits.
import { percentAt, type TrackEdits, type TrackHead } from "./timeline_edits";

export interface TrackValues extends TrackHead {
  /** Second of the movie at which it begins. */
  at_s: number;
  /** "force", "vibration", or both. */
  parts: string[];
}

/** The drives of an instant, 0 to 1: the strongest actuator by force and by vibration, and on which side of the array. */
export interface Level {
  strong: number;
  weak: number;
  /** -1 (left) to 1. */
  side: number;
}

export const FULL = 255;
const MARGIN = 1e-6; // of a frame: an instant that is written in seconds lies on its frame

export class Track {
  /** The strongest actuator of each frame, before the edits. */
  readonly peaks: Uint8Array;
  readonly highest: number;
  /** Of the two latest edits: for every power of two, the maxima of as many frames. */
  private maxima: { edits: TrackEdits; levels: Uint8Array[] }[] = [];

  constructor(readonly head: TrackValues, readonly columns: number, private readonly actuators: number, private readonly force: Uint8Array | null, private readonly vibration: Uint8Array | null) {
    this.peaks = new Uint8Array(head.frames);
    for (const table of [force, vibration])
      if (table) for (let n = 0; n < head.frames; n++) this.peaks[n] = Math.max(this.peaks[n]!, peakOf(table, n * actuators, actuators));
    this.highest = this.peaks.reduce((a, b) => Math.max(a, b), 0);
  }

  get name(): string {
    return this.head.name;
  }

  startS(edits: TrackEdits): number {
    return this.head.at_s + edits.offsetMs / 1000;
  }

  endS(edits: TrackEdits): number {
    return this.startS(edits) + this.head.frames / this.head.rate_hz;
  }

  /** The frame of an instant of the movie; it may lie outside of the track. */
  frameAt(time: number, edits: TrackEdits): number {
    return Math.floor((time - this.startS(edits)) * this.head.rate_hz + MARGIN);
  }

  timeOf(frame: number, edits: TrackEdits): number {
    return this.startS(edits) + frame / this.head.rate_hz;
  }

  /** The frames of a span of the movie, at least one; null: the span has none of the track. */
  framesOf(from: number, to: number, edits: TrackEdits): [number, number] | null {
    const { frames, rate_hz } = this.head;
    const first = Math.max(0, Math.round((from - this.startS(edits)) * rate_hz));
    const stop = Math.min(frames, Math.max(first + 1, Math.round((to - this.startS(edits)) * rate_hz)));
    return first < stop ? [first, stop] : null;
  }

  /** By what the drives of a frame are multiplied. */
  factor(frame: number, edits: TrackEdits): number {
    return edits.isMuted || frame < 0 || frame >= this.head.frames ? 0 : percentAt(edits.runs, frame) / 100;
  }

  /** The drive of each actuator at an instant, the greater of force and vibration, 0 to 1. */
  addDrives(time: number, edits: TrackEdits, drives: Float32Array): void {
    const frame = this.frameAt(time, edits);
    const factor = this.factor(frame, edits) / FULL;
    if (!factor) return;
    for (const table of [this.force, this.vibration])
      if (table) for (let n = 0, at = frame * this.actuators; n < this.actuators; n++, at++) drives[n] = Math.min(1, Math.max(drives[n]!, factor * table[at]!));
  }

  level(time: number, edits: TrackEdits): Level {
    const frame = this.frameAt(time, edits);
    const factor = this.factor(frame, edits) / FULL;
    if (!factor) return { strong: 0, weak: 0, side: 0 };
    const peak = (table: Uint8Array | null): number => (table ? Math.min(1, factor * peakOf(table, frame * this.actuators, this.actuators)) : 0);
    return { strong: peak(this.force), weak: peak(this.vibration), side: this.side(this.force ?? this.vibration!, frame * this.actuators) };
  }

  private side(table: Uint8Array, at: number): number {
    let [sum, moment] = [0, 0];
    for (let n = 0; n < this.actuators; n++) {
      sum += table[at + n]!;
      moment += table[at + n]! * (n % this.columns);
    }
    return sum && this.columns > 1 ? (2 * moment) / sum / (this.columns - 1) - 1 : 0;
  }

  /** The largest drive of frames `first` to `stop` - 1 after the edits, 0 to 255. */
  largest(first: number, stop: number, edits: TrackEdits): number {
    const levels = this.levelsOf(edits);
    let [low, high, out] = [Math.max(0, first), Math.min(stop, this.head.frames), 0];
    for (let level = 0; low < high; level++, low >>= 1, high >>= 1) {
      const maxima = levels[level]!;
      if (low & 1) out = Math.max(out, maxima[low++]!);
      if (high & 1) out = Math.max(out, maxima[--high]!);
    }
    return out;
  }

  private levelsOf(edits: TrackEdits): Uint8Array[] {
    const known = this.maxima.find((entry) => entry.edits === edits);
    if (known) return known.levels;
    const levels = pyramidOf(this.edited(edits));
    this.maxima = [...this.maxima.slice(-1), { edits, levels }];
    return levels;
  }

  /** The strongest actuator of each frame after the edits. */
  private edited({ isMuted, runs }: TrackEdits): Uint8Array {
    const out = new Uint8Array(this.peaks.length);
    if (isMuted) return out;
    out.set(this.peaks);
    for (const { first, stop, percent } of runs)
      for (let n = first; n < stop; n++) out[n] = Math.min(FULL, Math.round((this.peaks[n]! * percent) / 100));
    return out;
  }
}

/** Values, the maxima of pairs, of pairs of pairs, and so on. */
function pyramidOf(values: Uint8Array): Uint8Array[] {
  const levels = [values];
  for (let level = values; level.length > 1; levels.push(level)) {
    const half = new Uint8Array((level.length + 1) >> 1);
    for (let n = 0; n < half.length; n++) half[n] = Math.max(level[2 * n]!, level[2 * n + 1] ?? 0);
    level = half;
  }
  return levels;
}

function peakOf(table: Uint8Array, at: number, count: number): number {
  let peak = 0;
  for (let n = at; n < at + count; n++) if (table[n]! > peak) peak = table[n]!;
  return peak;
}

/** The tables of all tracks, one after the other as Python writes them. */
export function tracksOf(values: TrackValues[], columns: number, actuators: number, data: Uint8Array): Track[] {
  let at = 0;
  const next = (head: TrackValues, part: string): Uint8Array | null => (head.parts.includes(part) ? data.subarray(at, (at += head.frames * actuators)) : null);
  return values.map((head) => new Track(head, columns, actuators, next(head, "force"), next(head, "vibration")));
}
