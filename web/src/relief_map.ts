// Heights of the surface of a field: where a finger that comes from outside, along one axis, first meets a force. The page
// speaks them, and follows the surface with them. Pins of an array have heights of their own.
import type { Engine, Triple } from "./engine";

/** The direction that a finger comes from, and those in which it moves over the surface, as a viewer has them. */
export interface Outward {
  outward: Triple;
  right: Triple;
  ahead: Triple;
}

/** Where a probe walks to over a surface. */
export interface Walk extends Outward {
  at: Triple;
  /** Metres that the probe lies behind the surface. */
  depth: number;
  /** Metres to the places around whose heights are compared: to the right and ahead. */
  steps: [number, number];
}

/** The probe on the surface, and heights in metres, or of pins as a fraction of their travel; NaN: no surface. */
export interface Walked {
  point: Triple;
  height: number;
  /** Heights around: from behind left, row after row to ahead right, with the middle one. */
  around: Float64Array;
}

/** The lowest and the highest height of a surface, as `Walked` has them, and the column of the highest. */
export interface Extremes {
  lowest: number;
  highest: number;
  point: Triple;
}

const MOST_COLUMNS = 192; // along a side
const MOST_CANDIDATES = 400;
const HALVINGS = 10;

const axisOf = (direction: Triple): number => direction.findIndex((n) => n !== 0);

export class ReliefMap {
  private readonly axis: number;
  private readonly sign: number;
  /** The sign of a height outwards; of pins, whose heights are no coordinates, 1. */
  private readonly unit: number;

  constructor(private readonly engine: Engine, private readonly directions: Outward) {
    this.axis = axisOf(directions.outward);
    this.sign = directions.outward[this.axis]!;
    this.unit = engine.opened().type === 2 ? 1 : this.sign;
  }

  /** Metres along the axis at which the column through a point first has a force, from outside; NaN: nowhere. */
  surface(at: Triple): number {
    const { origin, spacing, shape, type } = this.engine.opened();
    const k = this.axis;
    if (type === 2) return this.pin(at);
    const from = [...at] as Triple;
    from[k] = this.sign > 0 ? origin[k]! + spacing[k]! * shape[k]! : origin[k]! - spacing[k]!;
    const met = this.engine.contact(from, this.directions.outward.map((n) => -n) as Triple, 0, null);
    if (!met) return NaN;
    const probe = met.entry;
    let [outside, inside] = [probe[k]! + 0.5 * this.sign * Math.min(...spacing), probe[k]!];
    for (let n = 0; n < HALVINGS; n++) {
      probe[k] = (outside + inside) / 2;
      if (this.engine.hasForce(probe)) inside = probe[k]!;
      else outside = probe[k]!;
    }
    return inside;
  }

  /** The height of a pin: a fraction of its travel. */
  private pin(at: Triple): number {
    const { origin, spacing, shape, peak } = this.engine.opened();
    const isWithin = [0, 1].every((n) => Math.abs((at[n]! - origin[n]!) / spacing[n]! - (shape[n]! - 1) / 2) <= shape[n]! / 2);
    const [x, y, z] = this.engine.feel(at);
    return isWithin ? Math.hypot(x!, y!, z!) / (peak || 1) : NaN;
  }

  walk({ at, depth, steps }: Walk): Walked {
    const { right, ahead } = this.directions;
    const around = new Float64Array(9);
    for (let n = 0; n < 9; n++) {
      const [i, j] = [(n % 3) - 1, Math.floor(n / 3) - 1];
      around[n] = this.unit * this.surface(at.map((v, k) => v + i * steps[0] * right[k]! + j * steps[1] * ahead[k]!) as Triple);
    }
    const point = [...at] as Triple;
    const height = around[4]!;
    if (this.engine.opened().type !== 2 && !Number.isNaN(height)) point[this.axis] = this.sign * (height - depth);
    return { point, height, around };
  }

  /** Heights of the columns through points. */
  profile(points: number[]): Float64Array {
    return Float64Array.from({ length: points.length / 3 }, (_, n) => this.unit * this.surface(points.slice(3 * n, 3 * n + 3) as Triple));
  }

  /** The lowest and the highest point of the surface; null where nothing has a force. */
  extremes(): Extremes | null {
    const tops = this.tops();
    if (!tops.size) return null;
    const ends = [Math.min(...tops.keys()), Math.max(...tops.keys())];
    let [lowest, highest, point] = [Infinity, -Infinity, [0, 0, 0] as Triple];
    for (const [top, columns] of tops) {
      if (top > ends[0]! && top < ends[1]! - 1) continue; // a sample higher than those could not be the first met
      const every = Math.ceil(columns.length / MOST_CANDIDATES);
      for (let n = 0; n < columns.length; n += every) {
        const height = this.unit * this.surface(columns[n]!);
        if (Number.isNaN(height)) continue;
        lowest = Math.min(lowest, height);
        if (height > highest) [highest, point] = [height, columns[n]!];
      }
    }
    return { lowest, highest, point };
  }

  /** Columns of the lattice by the number of their outermost sample with a force. */
  private tops(): Map<number, Triple[]> {
    const { origin, spacing, shape, type, peak } = this.engine.opened();
    const [k, a, b] = [this.axis, (this.axis + 1) % 3, (this.axis + 2) % 3];
    const tops = new Map<number, Triple[]>();
    const stride = [a, b].map((n) => Math.ceil(shape[n]! / MOST_COLUMNS)) as [number, number];
    const step = [...spacing] as Triple;
    step[b] = step[b]! * stride[1];
    const count = [...shape] as Triple;
    count[b] = Math.ceil(shape[b]! / stride[1]);
    for (let i = 0; i < shape[a]!; i += stride[0]) {
      const from = [...origin] as Triple;
      from[a] = from[a]! + i * spacing[a]!;
      const forces = this.engine.forces(from, b, k, step, count);
      for (let j = 0; j < count[b]!; j++) {
        const at = [...from] as Triple;
        at[b] = at[b]! + j * step[b]!;
        const top = type === 2 ? Math.round((1000 * this.engine.sizeAt(forces, j)) / (peak || 1)) : this.top(forces, j * shape[k]!, shape[k]!);
        if (top < 0) continue;
        if (!tops.has(top)) tops.set(top, []);
        tops.get(top)!.push(at);
      }
    }
    return tops;
  }

  /** How far out the outermost sample of a column with a force lies; -1: there is none. */
  private top(forces: Float32Array, start: number, count: number): number {
    for (let n = count - 1; n >= 0; n--) if (this.engine.isForce(forces, start + (this.sign > 0 ? n : count - 1 - n))) return n;
    return -1;
  }
}
