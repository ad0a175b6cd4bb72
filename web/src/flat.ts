// Draws the view of the page where there is no WebGL: a slice through the probe, or the actuators of an array, on a canvas of
// two dimensions. What it cannot show (the surface as a whole, a view that turns) the page says.
import type { Directions } from "./axes";
import { rowOf, TABLE } from "./colour";
import type { Away, Cut, Head, Ray, Shown, Triple } from "./engine";

const ARROWS = 24;
const MARGIN = 44; // pixels around the box, for the names of its axes
const LEGEND = 130; // pixels to the left of it, where the legend lies on the picture
const CAPTION = 90; // and below
const NARROW = 760; // pixels; below, legend and caption lie under the picture
const FIRST_RAYS = 90;

/** An axis of the picture: that of the file, and 1 where it grows to the right or up. */
type Side = [number, number];

export class FlatView {
  readonly isFlat = true;
  isOpen = false;
  readonly triangles = 0;
  readonly graphicsObjects = 0;
  cones = 0;
  bodies = 0;
  onDrawn: (() => void) | null = null;
  private readonly paint: CanvasRenderingContext2D;
  private readonly picture = document.createElement("canvas");
  private head: Head | null = null;
  private directions: Directions | null = null;
  private names: string[] = [];
  private top = 1;
  private limit = Infinity;
  private slice: Cut | null = null;
  private probe: { point: Triple; force: ArrayLike<number>; text: string; proxy: Triple | null } | null = null;
  private isDue = false;

  constructor(private readonly canvas: HTMLCanvasElement, private readonly overlay: HTMLElement) {
    this.paint = canvas.getContext("2d")!;
    new ResizeObserver(() => this.due()).observe(canvas);
  }

  /** The axis across the first slice: the one that points at the viewer. */
  firstAxis(directions: Directions): number {
    return directions.towards.findIndex((n) => n !== 0);
  }

  start(head: Head, directions: Directions, names: { box: string; axes: string[] }): void {
    this.overlay.replaceChildren();
    this.head = head;
    this.directions = directions;
    this.names = names.axes;
    this.slice = this.probe = null;
    this.scale(head.peak);
  }

  scale(top: number, limit = Infinity): void {
    this.top = top;
    this.limit = limit;
    this.due();
  }

  /** Draw with the colours of the page, which have changed. */
  recolour(): void {
    this.due();
  }

  reset(): void {}
  orbit(): void {}
  away(): Away | null {
    return null;
  }
  dragged(): number {
    return 0;
  }

  show(shown: Shown): void {
    this.bodies = shown.parts;
    const { head } = this;
    if (shown.grid && head) {
      this.bodies = head.shape[0] * head.shape[1];
      this.slice = { axis: 2, at: head.origin[2], across: head.shape[0], up: head.shape[1], forces: shown.grid };
    }
    if (shown.cut) this.slice = shown.cut;
    this.due();
  }

  cut(cut: Cut): void {
    this.slice = cut;
    this.due();
  }

  setProbe(point: Triple, force: ArrayLike<number>, text: string, proxy: Triple | null): void {
    this.probe = { point, force, text, proxy };
    this.due();
  }

  due(): void {
    if (this.isDue) return;
    this.isDue = true;
    requestAnimationFrame(() => {
      this.isDue = false;
      this.draw();
    });
  }

  // -- places of the file and of the picture ------------------------------------------------------------------------

  /** The axes to the right and up of a slice across an axis. */
  private sides(axis: number): [Side, Side] {
    const { right, up, towards } = this.directions!;
    const side = (direction: Triple, sign = 1): Side => {
      const n = direction.findIndex((v) => v !== 0);
      return [n, sign * direction[n]!];
    };
    const [x, y] = [side(right), side(up)];
    if (axis === x[0]) return [side(towards), y]; // seen from the left
    return axis === y[0] ? [x, side(towards, -1)] : [x, y];
  }

  private low = (axis: number): number => this.head!.origin[axis]! - this.head!.spacing[axis]! / 2;
  private length = (axis: number): number => this.head!.spacing[axis]! * this.head!.shape[axis]!;

  /** The box in the picture: left, top, and pixels of a metre. */
  private frame(across: Side, up: Side): [number, number, number] {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const [w, h] = [this.length(across[0]), this.length(up[0])];
    const [beside, below] = innerWidth > NARROW ? [LEGEND, CAPTION] : [0, 0];
    const pixels = Math.max(Math.min((width - 2 * MARGIN - beside) / w, (height - 2 * MARGIN - below) / h), 1);
    return [(width + beside - pixels * w) / 2, (height - below - pixels * h) / 2, pixels];
  }

  /** Where a point is drawn. */
  private toPicture(point: ArrayLike<number>): [number, number] {
    const [across, up] = this.sides(this.slice!.axis);
    const [left, top, pixels] = this.frame(across, up);
    const part = ([axis, sign]: Side): number => (sign > 0 ? point[axis]! - this.low(axis) : this.low(axis) + this.length(axis) - point[axis]!);
    return [left + pixels * part(across), top + pixels * (this.length(up[0]) - part(up))];
  }

  /** The point of the slice at a position on the screen, within the box; null: there is no slice yet. */
  pointAt(x: number, y: number): Triple | null {
    if (!this.slice) return null;
    const box = this.canvas.getBoundingClientRect();
    const [across, up] = this.sides(this.slice.axis);
    const [left, top, pixels] = this.frame(across, up);
    const point: Triple = [0, 0, 0];
    point[this.slice.axis] = this.slice.at;
    const place = ([axis, sign]: Side, metres: number): void => {
      const from = Math.min(Math.max(metres, 0), this.length(axis));
      point[axis] = sign > 0 ? this.low(axis) + from : this.low(axis) + this.length(axis) - from;
    };
    place(across, (x - box.left - left) / pixels);
    place(up, this.length(up[0]) - (y - box.top - top) / pixels);
    return point;
  }

  /** A ray at the viewer's position of the screen; the page asks for `pointAt` first. */
  ray(): Ray {
    return this.raysFromMiddle()[0]!;
  }

  facing(_ray: Ray, through: Triple): Triple {
    return through;
  }

  /** Rays of a finger into the box, from its middle outwards, for a first contact. */
  raysFromMiddle(): Ray[] {
    const { outward, right, ahead } = this.directions!;
    const axes = [outward, right, ahead].map((d) => d.findIndex((n) => n !== 0)) as Triple;
    return Array.from({ length: FIRST_RAYS }, (_, n) => {
      const [turn, far] = [2.4 * n, 0.5 * Math.sqrt(n / FIRST_RAYS)];
      const from: Triple = [0, 0, 0];
      for (const axis of axes) from[axis] = this.low(axis) + this.length(axis) / 2;
      from[axes[0]] = from[axes[0]]! + outward[axes[0]]! * this.length(axes[0]);
      from[axes[1]] = from[axes[1]]! + far * Math.cos(turn) * this.length(axes[1]);
      from[axes[2]] = from[axes[2]]! + far * Math.sin(turn) * this.length(axes[2]);
      return { from, direction: outward.map((v) => -v) as Triple };
    });
  }

  // -- drawing ------------------------------------------------------------------------------------------------------

  private draw(): void {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    this.canvas.width = width * devicePixelRatio;
    this.canvas.height = height * devicePixelRatio;
    this.paint.scale(devicePixelRatio, devicePixelRatio);
    if (!this.slice || !this.head) return;
    const [across, up] = this.sides(this.slice.axis);
    const [left, top, pixels] = this.frame(across, up);
    const [w, h] = [pixels * this.length(across[0]), pixels * this.length(up[0])];
    this.colours(this.slice, across, up);
    this.paint.imageSmoothingEnabled = this.head.type === 1;
    this.paint.drawImage(this.picture, left, top, w, h);
    const ink = getComputedStyle(this.canvas).color;
    this.paint.strokeStyle = this.paint.fillStyle = ink;
    this.paint.strokeRect(left, top, w, h);
    this.paint.font = getComputedStyle(this.canvas).font;
    this.paint.textAlign = "center";
    this.paint.fillText(this.names[across[0]] ?? "", left + w / 2, top + h + 20);
    this.paint.save();
    this.paint.translate(left - 10, top + h / 2);
    this.paint.rotate(-Math.PI / 2);
    this.paint.fillText(this.names[up[0]] ?? "", 0, 0);
    this.paint.restore();
    if (this.head.type === 1) this.arrows(this.slice, across, up);
    this.drawProbe();
    this.onDrawn?.();
  }

  /** The picture of |F|, a pixel a sample, the way round that it is seen. */
  private colours(cut: Cut, across: Side, up: Side): void {
    const isSwapped = across[0] !== (cut.axis + 1) % 3;
    const [m, n] = isSwapped ? [cut.up, cut.across] : [cut.across, cut.up];
    [this.picture.width, this.picture.height] = [m, n];
    const image = new ImageData(m, n);
    for (let j = 0; j < n; j++)
      for (let i = 0; i < m; i++) {
        const [x, y] = [across[1] > 0 ? i : m - 1 - i, up[1] > 0 ? n - 1 - j : j];
        const at = isSwapped ? y * cut.up + x : x * cut.up + y;
        const size = Math.hypot(cut.forces[3 * at]!, cut.forces[3 * at + 1]!, cut.forces[3 * at + 2]!) / this.top;
        const row = rowOf(size, this.limit);
        for (let k = 0; k < 3; k++) image.data[4 * (j * m + i) + k] = TABLE[row + k]!;
        image.data[4 * (j * m + i) + 3] = size > 1e-3 || this.head!.type === 2 ? 255 : 0;
      }
    this.picture.getContext("2d")!.putImageData(image, 0, 0);
  }

  /** Arrows of the force in the plane of the slice. */
  private arrows(cut: Cut, across: Side, up: Side): void {
    const [a, b] = [(cut.axis + 1) % 3, (cut.axis + 2) % 3];
    const every = Math.max(1, Math.ceil(Math.max(cut.across, cut.up) / ARROWS));
    const far = (0.8 * every * this.frame(across, up)[2] * this.length(a)) / cut.across;
    this.cones = 0;
    this.paint.strokeStyle = "#fff";
    for (let i = every >> 1; i < cut.across; i += every)
      for (let j = every >> 1; j < cut.up; j += every) {
        const force = cut.forces.subarray(3 * (i * cut.up + j), 3 * (i * cut.up + j) + 3);
        const size = Math.hypot(force[0]!, force[1]!, force[2]!);
        if (size < 0.01 * this.top) continue;
        const at = [0, 0, 0];
        at[a] = this.low(a) + ((i + 0.5) * this.length(a)) / cut.across;
        at[b] = this.low(b) + ((j + 0.5) * this.length(b)) / cut.up;
        this.arrow(this.toPicture(at), (across[1] * force[across[0]]!) / size, (-up[1] * force[up[0]]!) / size, far);
        this.cones++;
      }
  }

  private arrow([x, y]: [number, number], right: number, down: number, length: number): void {
    const [dx, dy] = [right * length, down * length];
    this.paint.beginPath();
    this.paint.moveTo(x - dx / 2, y - dy / 2);
    this.paint.lineTo(x + dx / 2, y + dy / 2);
    this.paint.moveTo(x + dx / 6 - dy / 4, y + dy / 6 + dx / 4);
    this.paint.lineTo(x + dx / 2, y + dy / 2);
    this.paint.lineTo(x + dx / 6 + dy / 4, y + dy / 6 - dx / 4);
    this.paint.stroke();
  }

  private drawProbe(): void {
    if (!this.probe) return;
    const { point, force, text, proxy } = this.probe;
    const [x, y] = this.toPicture(point);
    const [across, up] = this.sides(this.slice!.axis);
    const size = Math.hypot(force[0]!, force[1]!, force[2]!) || 1;
    const accent = getComputedStyle(this.canvas).getPropertyValue("--accent");
    this.paint.lineWidth = 3;
    this.paint.strokeStyle = this.paint.fillStyle = accent;
    const far = 24 + 60 * Math.min(size / this.top, 1);
    const [dx, dy] = [(across[1] * force[across[0]]!) / size, (-up[1] * force[up[0]]!) / size];
    this.arrow([x + (far * dx) / 2, y + (far * dy) / 2], dx, dy, far);
    this.disc(x, y, 7, accent);
    if (proxy) this.disc(...this.toPicture(proxy), 4, "#fff");
    this.paint.textAlign = "left";
    this.paint.lineWidth = 4;
    this.paint.strokeStyle = getComputedStyle(this.canvas).getPropertyValue("--ground");
    this.paint.fillStyle = getComputedStyle(this.canvas).color;
    this.paint.strokeText(text, x + 14, y + 24);
    this.paint.fillText(text, x + 14, y + 24);
    this.paint.lineWidth = 1;
  }

  private disc(x: number, y: number, radius: number, colour: string): void {
    this.paint.beginPath();
    this.paint.arc(x, y, radius, 0, 2 * Math.PI);
    this.paint.fillStyle = colour;
    this.paint.fill();
    this.paint.strokeStyle = "#fff";
    this.paint.stroke();
  }
}
