// Compares the decoded field with its source for the page: the error at each sample, in units of the mask
// max(F_0, k |F|) of the source.
import { Fault } from "./container";
import type { Away, Cut, Engine, Shown, Triple } from "./engine";

export class Difference {
  private readonly k: number;
  private readonly floor: number;

  constructor(private readonly decoded: Engine, private readonly source: Engine) {
    const [ours, theirs] = [decoded.opened(), source.opened()];
    if (`${ours.shape} ${ours.frames} ${ours.type}` !== `${theirs.shape} ${theirs.frames} ${theirs.type}`) throw new Fault("corrupt", "the source lies on another lattice", null);
    this.k = ours.weber;
    this.floor = Math.max(ours.threshold, 1e-6 * ours.peak);
  }

  /** |decoded - source| along x, y, z in units of the mask, the mask in newtons, and 0: five numbers a point. */
  feel(points: ArrayLike<number>): Float64Array {
    const [ours, theirs] = [this.decoded.feel(points), this.source.feel(points)];
    for (let i = 0; i < ours.length; i += 5) {
      const allowed = Math.max(this.floor, this.k * Math.hypot(theirs[i]!, theirs[i + 1]!, theirs[i + 2]!));
      for (let n = 0; n < 3; n++) ours[i + n] = (ours[i + n]! - theirs[i + n]!) / allowed;
      ours[i + 3] = allowed;
      ours[i + 4] = 0;
    }
    return ours;
  }

  contact(from: Triple, way: Triple, depth: number, away: Away | null): Triple | null {
    return this.decoded.contact(from, way, depth, away);
  }

  seek(time: number): void {
    this.decoded.seek(time);
    this.source.seek(time);
  }

  show(time: number, axis: number, at: number | null, depth: number): Shown {
    const begin = performance.now();
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
    if (shown.grid) this.take(shown.grid, this.source.grid());
    return { ...shown, memory: shown.memory + this.source.memory, ms: performance.now() - begin };
  }

  cut(axis: number, at: number): Cut {
    const cut = this.decoded.cut(axis, at);
    this.take(cut.forces, this.source.cut(axis, at).forces);
    return cut;
  }

  private take(ours: Float32Array, theirs: Float32Array): void {
    for (let i = 0; i < ours.length; i += 3) {
      const allowed = Math.max(this.floor, this.k * Math.hypot(theirs[i]!, theirs[i + 1]!, theirs[i + 2]!));
      for (let n = i; n < i + 3; n++) ours[n] = (ours[n]! - theirs[n]!) / allowed;
    }
  }
}
