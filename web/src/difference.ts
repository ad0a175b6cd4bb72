// Compares the decoded field with its source for the page: the error at each sample, in units of the mask
// max(F_0, k |F|) of the source.
import { Fault } from "./container";
import type { Away, Cut, Engine, Shown, Triple } from "./engine";

export class Difference {
  private readonly k: number;
  private readonly floor: number;

  constructor(private readonly decoded: Engine, private readonly source: Engine) {
    const [head, other] = [decoded.opened(), source.opened()];
    if (`${head.shape} ${head.frames} ${head.type}` !== `${other.shape} ${other.frames} ${other.type}`) throw new Fault("corrupt", "the source lies on another lattice", null);
    this.k = head.weber;
    this.floor = Math.max(head.threshold, 1e-6 * head.peak);
  }

  /** |decoded - source| along x, y, z in units of the mask, the mask in newtons, and 0: five numbers a point. */
  feel(points: ArrayLike<number>): Float64Array {
    const [decoded, source] = [this.decoded.feel(points), this.source.feel(points)];
    for (let i = 0; i < decoded.length; i += 5) {
      const bound = Math.max(this.floor, this.k * Math.hypot(source[i]!, source[i + 1]!, source[i + 2]!));
      for (let n = 0; n < 3; n++) decoded[i + n] = (decoded[i + n]! - source[i + n]!) / bound;
      decoded[i + 3] = bound;
      decoded[i + 4] = 0;
    }
    return decoded;
  }

  contact(from: Triple, direction: Triple, depth: number, away: Away | null): ReturnType<Engine["contact"]> {
    return this.decoded.contact(from, direction, depth, away);
  }

  seek(time: number): void {
    this.decoded.seek(time);
    this.source.seek(time);
  }

  show(time: number, axis: number, at: number | null, depth: number): Shown {
    const start = performance.now();
    this.source.seek(time);
    this.decoded.forget();
    const shown = this.decoded.show(time, axis, at, depth);
    for (const { part, vertex } of shown.meshes) {
      const p = shown.poses.subarray(12 * part, 12 * part + 12);
      const points = new Float64Array((3 * vertex.length) / 7);
      for (let i = 0, to = 0; i < vertex.length; i += 7)
        for (let row = 0; row < 3; row++, to++) {
          points[to] = p[9 + row]!;
          for (let n = 0; n < 3; n++) points[to]! += p[3 * row + n]! * (vertex[i + n]! - depth * vertex[i + 3 + n]!);
        }
      const between = this.feel(points);
      for (let n = 0; 7 * n < vertex.length; n++) vertex[7 * n + 6] = Math.hypot(...between.subarray(5 * n, 5 * n + 3));
    }
    if (shown.cut) shown.cut = this.cut(shown.cut.axis, shown.cut.at);
    if (shown.grid) this.subtract(shown.grid, this.source.grid());
    return { ...shown, memory: shown.memory + this.source.memory, ms: performance.now() - start };
  }

  cut(axis: number, at: number): Cut {
    const cut = this.decoded.cut(axis, at);
    this.subtract(cut.forces, this.source.cut(axis, at).forces);
    return cut;
  }

  private subtract(decoded: Float32Array, source: Float32Array): void {
    for (let i = 0; i < decoded.length; i += 3) {
      const bound = Math.max(this.floor, this.k * Math.hypot(source[i]!, source[i + 1]!, source[i + 2]!));
      for (let n = i; n < i + 3; n++) decoded[n] = (decoded[n]! - source[n]!) / bound;
    }
  }
}
