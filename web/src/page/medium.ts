// The medium that is open: what its file states, how its axes lie, and which of its fields is shown.
import { directionsOf, type Directions } from "../axes";
import type { Head, Opened, Triple, What } from "../engine";
import type { Given } from "../panel";
import { PIN_ARRAYS } from "../view";
import type { RemoteFile } from "./remote_file";

const COARSE = 0.02; // steps of keys, fractions of the box
const FINE = 0.004;

/** What is known of a medium besides its file. */
export interface Supplement {
  figures: Given;
  /** Whether the decoder has the source, too. */
  hasSource: boolean;
  /** Where segments come from, of a file that is read in parts. */
  remote: RemoteFile | null;
}

export class Medium {
  /** The field that is shown: decoded, source, or their difference; `field_choice.ts` assigns it. */
  what: What = "decoded";
  readonly head: Head;

  constructor(readonly name: string, readonly opened: Opened, readonly supplement: Supplement, readonly directions = directionsOf(opened.records.axes, opened.head.type === 2)) {
    this.head = opened.head;
  }

  /** What follows of a live medium: shown in the same way as this one. */
  continuedBy(opened: Opened, name: string): Medium {
    const next = new Medium(name, opened, { ...this.supplement, remote: null }, this.directions);
    next.what = this.what;
    return next;
  }

  /** Whether it is for an array of actuators, and not for a probe in a field. */
  get isArray(): boolean {
    return this.head.type === 2;
  }

  /** Whether the actuators are pins, which have heights. */
  get isPins(): boolean {
    return this.isArray && PIN_ARRAYS.test(this.opened.records.device);
  }

  get isError(): boolean {
    return this.what === "difference";
  }

  /** What the brightest colour stands for: newtons, or in a difference the error bound. */
  get top(): number {
    return this.isError ? 1 : this.head.peak;
  }

  /** Seconds from the first frame to the last. */
  get seconds(): number {
    return (this.head.frames - 1) / this.head.rate;
  }

  /** The box along an axis, metres: half a sample beyond the outermost samples. */
  range(axis: number): [number, number] {
    const { origin, spacing, shape } = this.head;
    return [origin[axis]! - spacing[axis]! / 2, origin[axis]! + spacing[axis]! * (shape[axis]! - 0.5)];
  }

  /** Sides of the box, metres. */
  get lengths(): Triple {
    return [0, 1, 2].map((n) => this.range(n)[1] - this.range(n)[0]) as Triple;
  }

  get middle(): Triple {
    const { origin, spacing, shape } = this.head;
    return origin.map((o, n) => o + 0.5 * spacing[n]! * (shape[n]! - 1)) as Triple;
  }

  /** The point of the box that is nearest to a point. */
  bounded(point: Triple): Triple {
    return point.map((m, n) => Math.min(Math.max(m, this.range(n)[0]), this.range(n)[1])) as Triple;
  }

  /** The actuator of an array that is nearest to a point; in a field the point itself. */
  snapped(point: Triple): Triple {
    const { origin, spacing, shape } = this.head;
    if (!this.isArray) return point;
    return point.map((v, n) => origin[n]! + spacing[n]! * Math.min(Math.max(Math.round((v - origin[n]!) / spacing[n]!), 0), shape[n]! - 1)) as Triple;
  }

  /** Metres of a key's step along an axis; of an array the way to the next actuator. */
  step(axis: number, isFine: boolean): number {
    return this.isArray ? this.head.spacing[axis]! : this.lengths[axis]! * (isFine ? FINE : COARSE);
  }

  /** Points on a line through a point, from the viewer's left to the right; fractions of the box. */
  lineThrough(point: Triple, fractions: number[]): Triple[] {
    const [axis, sign] = along(this.directions.right);
    const [low, high] = this.range(axis);
    return fractions.map((fraction) => point.map((v, n) => (n !== axis ? v : sign > 0 ? low + fraction * (high - low) : high - fraction * (high - low))) as Triple);
  }

  get isRemote(): boolean {
    return this.supplement.remote !== null;
  }

  /** Fetch what is shown about a time, of a file that is read in parts. */
  async fetch(time: number): Promise<void> {
    await this.supplement.remote?.fetch(time);
  }
}

/** The medium that is open. Modules that import it cannot assign it; only `opening.ts` calls `setMedium`. */
export let medium: Medium | null = null;

export function setMedium(next: Medium): void {
  medium = next;
}

/** The axis and sign of one of the viewer's directions. */
export function along(direction: Triple): [number, number] {
  const axis = direction.findIndex((n) => n !== 0);
  return [axis, direction[axis]!];
}

/** The directions that requests about a surface need. */
export function fingerOf({ outward, right, ahead }: Directions): Pick<Directions, "outward" | "right" | "ahead"> {
  return { outward, right, ahead };
}
