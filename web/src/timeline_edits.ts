// The edits of a movie's touch: strengths by frames, mute and offset of each track, with undo, and as the edit list that
// `touchfield edit --timeline` applies. Frames are whole numbers of a track, so that the page plays what the command writes.

/** A strength in percent of frames `first` to `stop` - 1 of a track. */
export interface Run {
  first: number;
  stop: number;
  percent: number;
}

export interface TrackEdits {
  isMuted: boolean;
  offsetMs: number;
  /** In order, without overlap, none of 100 percent. */
  runs: readonly Run[];
}

export type Edits = readonly TrackEdits[];

/** What an edit list states about a track, besides its edits. */
export interface TrackHead {
  name: string;
  frames: number;
  rate_hz: number;
  crc32: number;
}

export const MAX_PERCENT = 200;
export const MAX_OFFSET_MS = 3_600_000;
const UNCHANGED = 100;
const FORMAT = "touchfield-timeline";
const MAX_BYTES = 1 << 24;

export const NO_EDITS: TrackEdits = { isMuted: false, offsetMs: 0, runs: [] };

/** The runs with a strength for frames `first` to `stop` - 1 in place of what these had. */
export function withStrength(runs: readonly Run[], first: number, stop: number, percent: number): Run[] {
  const out: Run[] = [];
  for (const run of runs) {
    if (run.first < first) out.push({ ...run, stop: Math.min(run.stop, first) });
    if (run.stop > stop) out.push({ ...run, first: Math.max(run.first, stop) });
  }
  if (percent !== UNCHANGED) out.push({ first, stop, percent });
  out.sort((a, b) => a.first - b.first);
  return joined(out);
}

/** Neighbours of one strength as one run. */
function joined(runs: readonly Run[]): Run[] {
  const out: Run[] = [];
  for (const run of runs) {
    const last = out.at(-1);
    if (last && last.stop === run.first && last.percent === run.percent) last.stop = run.stop;
    else out.push({ ...run });
  }
  return out;
}

export function percentAt(runs: readonly Run[], frame: number): number {
  let [low, high] = [0, runs.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (runs[middle]!.stop <= frame) low = middle + 1;
    else high = middle;
  }
  const run = runs[low];
  return run && run.first <= frame ? run.percent : UNCHANGED;
}

/** The strengths of frames `first` to `stop` - 1, in percent; frames outside of all runs have 100. */
export function strengthsOf(runs: readonly Run[], first: number, stop: number): Set<number> {
  const found = new Set<number>();
  let next = first;
  for (const run of runs) {
    if (run.stop <= first || run.first >= stop) continue;
    if (run.first > next) found.add(100);
    found.add(run.percent);
    next = run.stop;
  }
  if (next < stop) found.add(100);
  return found;
}

/** States of the edits, for undo and redo. */
export class History {
  private states: Edits[];
  private at = 0;
  private saved: Edits;

  constructor(first: Edits) {
    this.states = [first];
    this.saved = first;
  }

  get now(): Edits {
    return this.states[this.at]!;
  }

  get canUndo(): boolean {
    return this.at > 0;
  }

  get canRedo(): boolean {
    return this.at < this.states.length - 1;
  }

  get isSaved(): boolean {
    return this.now === this.saved;
  }

  push(edits: Edits): void {
    this.states = [...this.states.slice(0, this.at + 1), edits];
    this.at += 1;
  }

  step(by: -1 | 1): void {
    this.at = Math.min(Math.max(this.at + by, 0), this.states.length - 1);
  }

  markSaved(): void {
    this.saved = this.now;
  }
}

/** The edit list. */
export function editList(movie: string, heads: readonly TrackHead[], edits: Edits): string {
  const tracks = heads.map(({ name, frames, rate_hz, crc32 }, n) => ({
    name, frames, rate_hz, crc32, is_muted: edits[n]!.isMuted, offset_ms: edits[n]!.offsetMs,
    strengths: edits[n]!.runs.map(({ first, stop, percent }) => ({ first_frame: first, stop_frame: stop, percent })),
  }));
  return `${JSON.stringify({ format: FORMAT, version: 1, movie, tracks }, null, 1)}\n`;
}

type Values = Record<string, unknown>;

const isObject = (value: unknown): value is Values => typeof value === "object" && value !== null && !Array.isArray(value);

function wholeNumber(value: unknown, low: number, high: number, where: string): number {
  if (!Number.isInteger(value) || (value as number) < low || (value as number) > high) throw new Error(`${where} is not a whole number from ${low} to ${high}`);
  return value as number;
}

function runsOf(values: unknown, frames: number, where: string): Run[] {
  if (!Array.isArray(values)) throw new Error(`${where} has no list of strengths`);
  let next = 0;
  const runs = values.map((value: unknown, n): Run => {
    if (!isObject(value)) throw new Error(`strength ${n + 1} of ${where} is no object`);
    const first = wholeNumber(value.first_frame, next, frames - 1, `first_frame of strength ${n + 1} of ${where}`);
    next = wholeNumber(value.stop_frame, first + 1, frames, `stop_frame of strength ${n + 1} of ${where}`);
    return { first, stop: next, percent: wholeNumber(value.percent, 0, MAX_PERCENT, `percent of strength ${n + 1} of ${where}`) };
  });
  return joined(runs.filter(({ percent }) => percent !== UNCHANGED));
}

function trackOf(value: Values, head: TrackHead): TrackEdits {
  const where = `track ${head.name}`;
  if (value.frames !== head.frames || value.rate_hz !== head.rate_hz) throw new Error(`${where} has ${String(value.frames)} frames at ${String(value.rate_hz)} Hz in the list, and ${head.frames} at ${head.rate_hz} Hz here`);
  const offsetMs = wholeNumber(value.offset_ms ?? 0, -MAX_OFFSET_MS, MAX_OFFSET_MS, `offset_ms of ${where}`);
  return { isMuted: value.is_muted === true, offsetMs, runs: runsOf(value.strengths ?? [], head.frames, where) };
}

/** The edits of a list that was saved for these tracks; throws an Error that says what is wrong with any other. */
export function editsOf(text: string, heads: readonly TrackHead[]): Edits {
  if (text.length > MAX_BYTES) throw new Error("it is longer than any edit list");
  let list: unknown;
  try {
    list = JSON.parse(text);
  } catch {
    throw new Error("it is no JSON");
  }
  if (!isObject(list) || list.format !== FORMAT || list.version !== 1 || !Array.isArray(list.tracks)) throw new Error("it is no edit list of this page");
  const tracks = list.tracks.filter(isObject);
  const unknown = tracks.find(({ name }) => !heads.some((head) => head.name === name));
  if (unknown) throw new Error(`the movie has no track ${String(unknown.name)}`);
  return heads.map((head) => {
    const value = tracks.find(({ name }) => name === head.name);
    return value ? trackOf(value, head) : NO_EDITS;
  });
}

/** The name of a movie's edit list, and the command that applies it. */
export function namesOf(movie: string): { name: string; command: string } {
  const stem = movie.replace(/\.[^.]*$/, "");
  const ending = /\.[^.]*$/.exec(movie)?.[0] ?? ".mp4";
  const name = `${stem}.edits.json`;
  return { name, command: `touchfield edit ${quoted(movie)} ${quoted(`${stem}-edited${ending}`)} --timeline ${quoted(name)}` };
}

const quoted = (name: string): string => (/^[\w./-]+$/.test(name) && !name.startsWith("-") ? name : `'${name.replaceAll("'", "'\\''")}'`);
