// Runs the decoder and encoder of c/touch.h in WebAssembly, and answers the requests of the page: open a
// file, show a frame, find the force at a point. It runs in a worker, or in the page where workers are not
// allowed.
import { Fault, faultOf, readRecords, type Records, provenanceBytes, provenanceOf } from "./container";
import { Difference } from "./difference";
import { PAGE_MATH } from "./hand";
import { DEFAULT_BOUND, type Relief } from "./relief";
import { type Outward, ReliefMap, type Walk } from "./relief_map";

interface Exports {
  memory: WebAssembly.Memory;
  room(bytes: number): number;
  open(): number;
  open_parts(): number;
  segment_of(frame: number): number;
  span(segment: number): number;
  check(segment: number): number;
  message(): number;
  number(n: number): number;
  show(frame: number): number;
  feel(x: number, y: number, z: number): number;
  plane(...numbers: number[]): number;
  parts(): number;
  pose(n: number): number;
  field_key(n: number): number;
  surface(n: number, threshold: number, depth: number): number;
  largest(n: number): number;
  provenance(bytes: number): number;
  record(from: number, count: number, k: number, threshold: number): number;
  record_relief(k: number, threshold: number): number;
  recorded(): number;
}

export type Triple = [number, number, number];

export interface Ray {
  from: Triple;
  direction: Triple;
}

/** Head of a file. */
export interface Head {
  shape: Triple;
  spacing: Triple;
  origin: Triple;
  rate: number;
  frames: number;
  segments: number;
  objects: number;
  type: number;
  peak: number;
  threshold: number;
  weber: number;
  friction: number;
  damping: number;
  scale: number;
  offset: Triple;
}

export interface Mesh {
  part: number;
  vertex: Float32Array;
  index: Uint32Array;
}

export interface Cut {
  axis: number;
  at: number;
  across: number;
  up: number;
  forces: Float32Array;
}

/** The side of the surface that is not drawn: the side (1 or -1) of a plane across an axis. */
export interface Away {
  axis: number;
  at: number;
  side: number;
}

/** A segment with the records before it, and its bytes in the file. */
export interface Piece {
  segment: number;
  from: number;
  to: number;
}

/** What is drawn at an instant; meshes only where they differ from those sent before. */
export interface Shown {
  time: number;
  parts: number;
  poses: Float64Array;
  meshes: Mesh[];
  cut: Cut | null;
  grid: Float32Array | null;
  largest: Float64Array;
  /** Bytes of the decoder, which grow with what a file needs. */
  memory: number;
  ms: number;
}

export interface Opened {
  head: Head;
  records: Records;
  memory: number;
  ms: number;
}

/** Frames to save, and the bound max(threshold, weber |F|) of their error: newtons, and a fraction. */
export interface Recording {
  from: number;
  count: number;
  weber: number;
  threshold: number;
  /** How the new file names its source. */
  name: string;
}

/** Where a ray meets a force: the point where it enters, the probe behind it, and the force there. */
export interface Met {
  entry: Triple;
  point: Triple;
  force: Float64Array;
}

export interface Recorded {
  data: Uint8Array<ArrayBuffer>;
  /** The largest error as a fraction of the bound. */
  ratio: number;
  ms: number;
}

const CODES = ["", "foreign file", "cut short", "corrupt", "another version", "too large", "argument", "end"];
const CUT_SIDE = 112;

/** The coder of a file that is of another version, or has a coder that is not known here. */
function coderOf(data: Uint8Array): string {
  try {
    const { coder } = readRecords(data);
    return coder && coder !== "touch" && coder !== "objects" ? `: the coder ${coder}` : "";
  } catch {
    return "";
  }
}

export class Engine {
  private readonly wasm: Exports;
  private head: Head | null = null;
  private keys: string[] = [];
  /** Of a file in parts: its address, its bytes, and the segments that have arrived. */
  private parts: { at: number; size: number; there: Set<number> } | null = null;
  private bytes = { at: 0, size: 0 };
  private records: Records | null = null;
  /** The picture that the open file was made of. */
  private relief: Relief | null = null;

  constructor(private readonly module: WebAssembly.Module) {
    this.wasm = new WebAssembly.Instance(module, { page: PAGE_MATH }).exports as unknown as Exports;
  }

  open(data: Uint8Array): Opened {
    const start = performance.now();
    this.room(data.length);
    this.bring(0, data, null);
    const code = this.wasm.open();
    this.parts = this.relief = null;
    if (code) throw faultOf(CODES[code] ?? "fault", code === 4 ? `${this.message()}${coderOf(data)}` : this.message(), data);
    return this.describe(readRecords(data), start);
  }

  /** Memory for a file in parts. */
  room(size: number): boolean {
    this.head = null;
    this.keys = [];
    const at = this.wasm.room(size);
    if (!at) throw new Fault("too large", "the file is larger than the memory of the page", null);
    this.parts = { at, size, there: new Set() };
    this.relief = null;
    this.bytes = { at, size };
    return true;
  }

  /** Bytes of the file, where they lie in it; those of a segment are compared with their entry in the index. */
  bring(at: number, data: Uint8Array, segment: number | null): boolean {
    const { parts } = this;
    if (!parts || at < 0 || at + data.length > parts.size) throw new Fault("argument", "bytes after the end of the file", null);
    new Uint8Array(this.wasm.memory.buffer).set(data, parts.at + at);
    if (segment === null) return true;
    const code = this.wasm.check(segment);
    if (code) throw new Fault(CODES[code] ?? "fault", `${this.message()}, in segment ${segment}`, null);
    parts.there.add(segment);
    return true;
  }

  /** Open a file of which the start, up to the first segment, the index and the end have arrived. */
  openParts(first: number): Opened {
    const start = performance.now();
    const { at, size } = this.parts!;
    const code = this.wasm.open_parts();
    if (code) throw new Fault(CODES[code] ?? "fault", this.message(), null);
    return this.describe(readRecords(new Uint8Array(this.wasm.memory.buffer, at, first).slice(), size), start);
  }

  private describe(records: Records, start: number): Opened {
    this.records = records;
    const n = (i: number): number => this.wasm.number(i);
    const three = (i: number): Triple => [n(i), n(i + 1), n(i + 2)];
    this.head = {
      shape: three(0), spacing: three(3), origin: three(6), rate: n(9), frames: n(10), segments: n(11), objects: n(12),
      type: n(13), peak: n(14), threshold: n(15), weber: n(16), friction: n(17), damping: n(18), scale: n(19),
      offset: three(20),
    };
    return { head: this.head, records, memory: this.memory, ms: performance.now() - start };
  }

  /** Open the file of a picture of depth, with the default error bound. */
  openRelief(relief: Relief): Opened & { data: Uint8Array } {
    const start = performance.now();
    const { data } = new Engine(this.module).recordRelief(relief, DEFAULT_BOUND);
    const opened = this.open(data);
    this.relief = relief;
    return { ...opened, data, ms: performance.now() - start };
  }

  /** A new file of a picture of depth. */
  private recordRelief({ numbers, depth, provenance }: Relief, { weber, threshold }: { weber: number; threshold: number }): Recorded {
    const start = performance.now();
    const at = this.wasm.room(numbers.byteLength + depth.byteLength);
    if (!at) throw new Fault("too large", "the picture is larger than the memory of the page", null);
    new Float64Array(this.wasm.memory.buffer, at, numbers.length).set(numbers);
    new Float32Array(this.wasm.memory.buffer, at + numbers.byteLength, depth.length).set(depth);
    return this.recorded(this.putProvenance(provenanceBytes(provenance)) || this.wasm.record_relief(weber, threshold), start);
  }

  /** A new file of some frames, coded in a decoder and memory of its own: what is shown stays. */
  record({ from, count, weber, threshold, name }: Recording): Recorded {
    const start = performance.now();
    const head = this.opened();
    if (head.objects) throw new Fault("argument", "the page saves fields of coder touch only, and this file has the coder objects", null);
    const own = new Engine(this.module);
    if (this.relief) return own.recordRelief(this.relief, { weber, threshold });
    const data = new Uint8Array(this.wasm.memory.buffer, this.bytes.at, this.bytes.size);
    own.room(data.length);
    own.bring(0, data, null);
    const provenance = provenanceOf(this.records!.provenance, name, from, count);
    const code = (this.parts ? own.wasm.open_parts() : own.wasm.open()) || own.putProvenance(provenance) || own.wasm.record(from, count, weber, threshold);
    return own.recorded(code, start);
  }

  /** The file that was written, if the code is 0. */
  private recorded(code: number, start: number): Recorded {
    if (code) throw new Fault(CODES[code] ?? "fault", this.message(), null);
    const [at, size, ratio] = new Float64Array(this.wasm.memory.buffer, this.wasm.recorded(), 3);
    return { data: new Uint8Array(this.wasm.memory.buffer, at, size).slice(), ratio: ratio!, ms: performance.now() - start };
  }

  private putProvenance(provenance: Uint8Array): number {
    const at = this.wasm.provenance(provenance.length);
    if (!at) throw new Fault("argument", "a provenance that is too long", null);
    new Uint8Array(this.wasm.memory.buffer).set(provenance, at);
    return 0;
  }

  private needed(time: number): number[] {
    const { frames, rate, objects, segments } = this.opened();
    const at = Math.min(Math.max(time * rate, 0), frames - 1);
    const own = new Set<number>();
    for (const frame of [Math.floor(at + 1e-9), Math.ceil(at)]) {
      const n = this.wasm.segment_of(frame);
      for (let k = objects ? -1 : 0; k <= (objects ? 1 : 0); k++) if (n + k >= 0 && n + k < segments) own.add(n + k); // bodies look beyond
    }
    return [...own];
  }

  /** Segments about a time that have not arrived. */
  missing(time: number): Piece[] {
    const { parts } = this;
    if (!parts) return [];
    return this.needed(time).filter((n) => !parts.there.has(n)).map((segment) => {
      const [from, to] = new Float64Array(this.wasm.memory.buffer, this.wasm.span(segment), 2);
      return { segment, from: from!, to: to! };
    });
  }

  /** Decode a small file some times, so that the browser has made its code fast before a large one comes. */
  warm(data: Uint8Array, times: number): boolean {
    for (let n = 0; n < times; n++) {
      this.open(data);
      this.show(0, 0, 0, 1e-3);
    }
    this.head = null;
    return true;
  }

  /** Decode what is about a time, seconds. */
  seek(time: number): void {
    const head = this.opened();
    if (this.missing(time).length) throw new Fault("argument", "a segment that has not arrived", null);
    const code = this.wasm.show(time * head.rate);
    if (!code) return;
    throw faultOf(CODES[code] ?? "fault", this.message(), null, `in frame ${Math.floor(time * head.rate)}`);
  }

  /** Newtons along x, y, z, amplitude in newtons and frequency in Hz of what vibrates: five numbers a point. */
  feel(points: ArrayLike<number>): Float64Array {
    const out = new Float64Array((points.length / 3) * 5);
    for (let i = 0; 3 * i < points.length; i++) {
      const at = this.wasm.feel(points[3 * i]!, points[3 * i + 1]!, points[3 * i + 2]!);
      out.set(new Float64Array(this.wasm.memory.buffer, at, 5), 5 * i);
    }
    return out;
  }

  /** Where a ray first meets a force, and goes on for `depth` metres; what is cut away is passed; null: nowhere. */
  contact(from: Triple, direction: Triple, depth: number, away: Away | null): { point: Triple; entry: Triple } | null {
    const head = this.opened();
    const step = 0.5 * Math.min(...head.spacing);
    let near = 0;
    let far = Infinity;
    for (let n = 0; n < 3; n++) {
      const low = (head.origin[n]! - head.spacing[n]! - from[n]!) / direction[n]!;
      const high = (head.origin[n]! + head.spacing[n]! * head.shape[n]! - from[n]!) / direction[n]!;
      if (Number.isNaN(low) || Number.isNaN(high)) continue;
      near = Math.max(near, Math.min(low, high));
      far = Math.min(far, Math.max(low, high));
    }
    let within = 0;
    if (away) {
      const t = (away.at - from[away.axis]!) / direction[away.axis]!;
      if ((from[away.axis]! - away.at) * away.side > 0) within = t > 0 ? t : Infinity;
      else if (t > 0) far = Math.min(far, t);
      near = Math.max(near, within);
    }
    const threshold = this.threshold();
    for (let t = near, left = 4000; t <= far && left > 0; t += step, left--) {
      const p: Triple = [from[0] + t * direction[0], from[1] + t * direction[1], from[2] + t * direction[2]];
      const f = this.feel(p);
      if (f[0]! * f[0]! + f[1]! * f[1]! + f[2]! * f[2]! > threshold * threshold)
        return { entry: p, point: t === within ? p : [p[0] + depth * direction[0], p[1] + depth * direction[1], p[2] + depth * direction[2]] };
    }
    return null;
  }

  show(time: number, cutAxis: number, cutAt: number | null, depth: number): Shown {
    const start = performance.now();
    const head = this.opened();
    this.seek(time);
    const { wasm } = this;
    const parts = wasm.parts();
    const poses = new Float64Array(12 * parts);
    const meshes: Mesh[] = [];
    let largest = new Float64Array(4);
    for (let n = 0; n < parts; n++) {
      poses.set(new Float64Array(wasm.memory.buffer, wasm.pose(n), 12), 12 * n);
      const own = wasm.field_key(n);
      const key = `${own ? `k${own}` : `f${Math.round(time * head.rate)}`} ${depth}`;
      if (this.keys[n] === key) continue;
      this.keys[n] = key;
      if (head.type === 1) meshes.push(this.mesh(n, depth));
      const strongest = new Float64Array(wasm.memory.buffer, wasm.largest(n), 4);
      if (strongest[0]! >= largest[0]!) largest = strongest.slice();
    }
    const grid = head.type === 2 ? this.grid() : null;
    const at = cutAt ?? this.firstCut(cutAxis, meshes, poses);
    const cut = head.type === 1 ? this.cut(cutAxis, at) : null;
    return { time, parts, poses, meshes, cut, grid, largest, memory: this.memory, ms: performance.now() - start };
  }

  get memory(): number {
    return this.wasm.memory.buffer.byteLength;
  }

  /** Send all meshes again with the next frame. */
  forget(): void {
    this.keys = [];
  }

  /** Forces of all actuators of an array. */
  grid(): Float32Array {
    const { origin, spacing, shape } = this.opened();
    return this.forces(origin, 0, 1, spacing, shape);
  }

  /** Position of a first slice: in the viewer's right half of the surface, where the forces in its plane vary most. */
  private firstCut(axis: number, meshes: Mesh[], poses: Float64Array): number {
    let [low, high] = [Infinity, -Infinity];
    for (const { part, vertex } of meshes) {
      const p = poses.subarray(12 * part, 12 * part + 12);
      for (let i = 0; i < vertex.length; i += 7) {
        const at = p[3 * axis]! * vertex[i]! + p[3 * axis + 1]! * vertex[i + 1]! + p[3 * axis + 2]! * vertex[i + 2]! + p[9 + axis]!;
        low = Math.min(low, at);
        high = Math.max(high, at);
      }
    }
    const { origin, spacing, shape } = this.opened();
    const middle = origin[axis]! + 0.5 * spacing[axis]! * shape[axis]!;
    let [best, most] = [middle, -1];
    for (let part = 0.5; low < high && part < 0.9; part += 0.04) {
      const at = low + part * (high - low);
      const { forces } = this.cut(axis, at);
      let variation = 0;
      for (let i = 3; i < forces.length; i++) if (i % 3 !== axis) variation += Math.abs(forces[i]! - forces[i - 3]!);
      if (variation > most) [best, most] = [at, variation];
    }
    return best;
  }

  /** Forces on a plane across an axis, at a position in metres, over the whole box. */
  cut(axis: number, at: number): Cut {
    const head = this.opened();
    const [a, b] = [(axis + 1) % 3, (axis + 2) % 3];
    const count = [1, 1, 1] as Triple;
    const step = [0, 0, 0] as Triple;
    for (const n of [a, b]) {
      count[n] = Math.min(CUT_SIDE, head.shape[n]!);
      step[n] = (head.spacing[n]! * head.shape[n]!) / count[n]!;
    }
    const from = head.origin.map((o, n) => (n === axis ? at : o - head.spacing[n]! / 2 + step[n]! / 2)) as Triple;
    return { axis, at, across: count[a]!, up: count[b]!, forces: this.forces(from, a, b, step, count) };
  }

  /** Forces on a part of a plane along two axes, from a point on. */
  forces(from: Triple, a: number, b: number, step: Triple, count: Triple): Float32Array {
    const along = [0, 0, 0];
    const up = [0, 0, 0];
    along[a] = step[a]!;
    up[b] = step[b]!;
    const at = this.wasm.plane(...from, ...along, ...up, count[a]!, count[b]!);
    if (!at) throw new Fault("too large", "a plane larger than the memory of the page", null);
    return new Float32Array(this.wasm.memory.buffer, at, 3 * count[a]! * count[b]!).slice();
  }

  /** Size of a force of many, newtons. */
  sizeAt(forces: Float32Array, n: number): number {
    return Math.hypot(forces[3 * n]!, forces[3 * n + 1]!, forces[3 * n + 2]!);
  }

  /** Whether a force of many counts as one that a hand meets. */
  isForce(forces: Float32Array, n: number): boolean {
    return this.sizeAt(forces, n) > this.threshold();
  }

  hasForce(point: Triple): boolean {
    const [x, y, z] = this.feel(point);
    return Math.hypot(x!, y!, z!) > this.threshold();
  }

  private threshold(): number {
    const { threshold, peak } = this.opened();
    return threshold > 0 ? Math.min(threshold, 0.05 * peak) : 0.02 * peak;
  }

  private mesh(part: number, depth: number): Mesh {
    const at = this.wasm.surface(part, this.threshold(), depth);
    const [vertex, index, vertices, indices] = new Uint32Array(this.wasm.memory.buffer, at, 4) as unknown as number[];
    if (!vertices) return { part, vertex: new Float32Array(0), index: new Uint32Array(0) };
    return {
      part,
      vertex: new Float32Array(this.wasm.memory.buffer, vertex, 7 * vertices).slice(),
      index: new Uint32Array(this.wasm.memory.buffer, index, indices).slice(),
    };
  }

  opened(): Head {
    if (!this.head) throw new Fault("argument", "no file is open", null);
    return this.head;
  }

  private message(): string {
    const bytes = new Uint8Array(this.wasm.memory.buffer);
    let text = "";
    for (let at = this.wasm.message(); bytes[at]; at++) text += String.fromCharCode(bytes[at]!);
    return text;
  }
}

// -- messages -----------------------------------------------------------------------------------------------------

/** The field that is shown. */
export type What = "decoded" | "source" | "difference";

export type EngineRequest =
  | { do: "start"; module: WebAssembly.Module }
  | { do: "warm"; data: Uint8Array; times: number }
  | { do: "open"; data: Uint8Array; source: Uint8Array | null }
  | { do: "relief"; relief: Relief }
  | { do: "room"; size: number }
  | { do: "bring"; at: number; data: Uint8Array; segment: number | null }
  | { do: "open-parts"; first: number }
  | { do: "missing"; time: number }
  | { do: "of"; what: What }
  | { do: "show"; time: number; axis: number; at: number | null; depth: number }
  | { do: "record"; recording: Recording }
  | { do: "cut"; axis: number; at: number }
  | { do: "feel"; points: number[] }
  | { do: "walk"; walk: Walk }
  | { do: "extremes"; directions: Outward }
  | { do: "profile"; directions: Outward; points: number[] }
  | { do: "contact"; time: number | null; rays: Ray[]; depth: number; away: Away | null };

let module: WebAssembly.Module;
let decoded: Engine | null = null;
let fields: Partial<Record<What, Engine | Difference>> = {};
let engine: Engine | Difference;

/** Open a file and its source. */
function open(data: Uint8Array, source: Uint8Array | null): Opened {
  const opened = decoded!.open(data);
  engine = decoded!;
  fields = { decoded: decoded! };
  if (source) {
    const sourceEngine = new Engine(module);
    sourceEngine.open(source);
    fields = { ...fields, source: sourceEngine, difference: new Difference(decoded!, sourceEngine) };
  }
  return opened;
}

/** The field whose surface a probe follows: the one that is shown, or in a difference the decoded one. */
const solid = (): Engine => (engine instanceof Engine ? engine : decoded!);

/** The answer to a request; a fault is an answer, too. */
export function answer(request: EngineRequest): unknown {
  try {
    if (request.do === "start") {
      module = request.module;
      engine = decoded = new Engine(module);
      return true;
    }
    if (!decoded) throw new Fault("fault", "the decoder has not started", null);
    if (request.do === "warm") return decoded.warm(request.data, request.times);
    if (request.do === "open") return open(request.data, request.source);
    if (request.do === "relief") {
      engine = decoded;
      fields = { decoded };
      return decoded.openRelief(request.relief);
    }
    if (request.do === "room") {
      engine = decoded;
      fields = { decoded };
      return decoded.room(request.size);
    }
    if (request.do === "bring") return decoded.bring(request.at, request.data, request.segment);
    if (request.do === "open-parts") return decoded.openParts(request.first);
    if (request.do === "missing") return decoded.missing(request.time);
    if (request.do === "of") {
      engine = fields[request.what] ?? decoded;
      if (engine instanceof Engine) engine.forget();
      return true;
    }
    if (request.do === "show") return engine.show(request.time, request.axis, request.at, request.depth);
    if (request.do === "record") {
      if (engine instanceof Engine) return engine.record(request.recording);
      throw new Fault("argument", "a difference is not a field: show decoded or source", null);
    }
    if (request.do === "cut") return engine.cut(request.axis, request.at);
    if (request.do === "feel") return engine.feel(request.points);
    if (request.do === "walk") {
      const walked = new ReliefMap(solid(), request.walk).walk(request.walk);
      return { ...walked, field: engine.feel(walked.point) };
    }
    if (request.do === "profile") return new ReliefMap(solid(), request.directions).profile(request.points);
    if (request.do === "extremes") return new ReliefMap(solid(), request.directions).extremes();
    if (request.time !== null) engine.seek(request.time);
    let met: Met | null = null;
    for (const { from, direction } of request.rays) {
      const found = engine.contact(from, direction, request.depth, request.away);
      if (!found) continue;
      const force = engine.feel(found.point);
      met ??= { ...found, force };
      if (force[0] || force[1] || force[2]) return { ...found, force }; // and not through a thin wall
    }
    return met;
  } catch (error) {
    if (error instanceof Fault) return { fault: error.kind, message: error.message, byte: error.byte };
    return { fault: "fault", message: String(error), byte: null };
  }
}
